// The list of pictures: only the rows that are seen exist, however many pictures there are.

import { address } from "/static/link.js";

const ROW = 68; // pixels, as in annotate.css

export class PictureList {
  constructor(box, spacer, chosen) {
    Object.assign(this, { box, spacer, chosen, pictures: [], current: null, rows: new Map() });
    box.addEventListener("scroll", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(box);
    box.addEventListener("keydown", (event) => this.key(event));
  }

  show(pictures, current) {
    this.pictures = pictures;
    this.current = current;
    this.spacer.style.height = `${pictures.length * ROW}px`;
    this.draw();
  }

  // Have the current picture in sight.
  reveal() {
    const index = this.pictures.findIndex((picture) => picture.name === this.current);
    const top = index * ROW;
    if (index < 0) return;
    if (top < this.box.scrollTop || top + ROW > this.box.scrollTop + this.box.clientHeight) {
      this.box.scrollTop = top - this.box.clientHeight / 2;
    }
    this.draw();
  }

  draw() {
    const first = Math.max(0, Math.floor(this.box.scrollTop / ROW) - 3);
    const last = Math.min(this.pictures.length, first + Math.ceil(this.box.clientHeight / ROW) + 7);
    const wanted = new Map();
    for (let index = first; index < last; index++) wanted.set(this.pictures[index].name, index);
    for (const [name, row] of this.rows) {
      if (wanted.has(name)) continue;
      row.remove();
      this.rows.delete(name);
    }
    for (const [name, index] of wanted) {
      const row = this.rows.get(name) ?? this.made(name);
      row.style.top = `${index * ROW}px`;
      row.setAttribute("aria-selected", name === this.current);
      row.querySelector("small").textContent = said(this.pictures[index]);
    }
  }

  made(name) {
    const row = document.createElement("button");
    row.className = "row";
    row.type = "button";
    row.tabIndex = -1;
    row.setAttribute("role", "option");
    row.title = name;
    const image = document.createElement("img");
    image.alt = "";
    image.src = address("thumbnail", { name });
    const text = document.createElement("span");
    text.append(document.createElement("b"), document.createElement("small"));
    text.firstChild.textContent = name;
    row.append(image, text);
    row.addEventListener("click", () => this.chosen(name));
    this.rows.set(name, row);
    this.box.append(row);
    return row;
  }

  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8 }[event.key];
    if (!step || !this.pictures.length) return;
    event.preventDefault();
    event.stopPropagation();
    const index = this.pictures.findIndex((picture) => picture.name === this.current) + step;
    this.chosen(this.pictures[Math.min(Math.max(index, 0), this.pictures.length - 1)].name);
  }
}

function said({ trust, events, confirmed }) {
  const words = [trust === null ? "not looked at" : `trust ${trust.toFixed(2)}`];
  if (events) words.push(`${confirmed ? "✓ " : ""}${events} ${events === 1 ? "event" : "events"}`);
  return words.join(" · ");
}
