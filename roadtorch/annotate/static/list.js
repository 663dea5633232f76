// The list of images; the browser lays out and loads only visible rows.

import { address } from "/static/client.js";

export class ImageList {
  constructor(box, chosen) {
    Object.assign(this, { box, chosen, names: [], current: null, rows: new Map() });
    box.addEventListener("keydown", (event) => this.key(event));
  }

  show(images, current) {
    this.names = images.map(({ name }) => name);
    this.current = current;
    for (const image of images) {
      if (!this.rows.has(image.name)) this.rows.set(image.name, this.makeRow(image.name));
      const row = this.rows.get(image.name);
      row.ariaSelected = image.name === current;
      row.querySelector("small").textContent = describe(image);
    }
    const rows = this.names.map((name) => this.rows.get(name));
    const { children } = this.box;
    if (rows.length !== children.length || rows.some((row, index) => row !== children[index])) {
      this.box.replaceChildren(...rows);
    }
  }

  // Scroll to the open image.
  reveal() {
    this.rows.get(this.current)?.scrollIntoView({ block: "nearest" });
  }

  makeRow(name) {
    const row = Object.assign(document.createElement("button"), {
      className: "row", type: "button", tabIndex: -1, role: "option", title: name,
    });
    const image = Object.assign(document.createElement("img"), { alt: "", loading: "lazy" });
    image.src = address("thumbnail", { name });
    const text = document.createElement("span");
    text.append(document.createElement("b"), document.createElement("small"));
    text.firstChild.textContent = name;
    row.append(image, text);
    row.addEventListener("click", () => this.chosen(name));
    return row;
  }

  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 8, PageUp: -8 }[event.key];
    if (!step || !this.names.length) return;
    event.preventDefault();
    event.stopPropagation();
    const index = this.names.indexOf(this.current) + step;
    this.chosen(this.names[Math.min(Math.max(index, 0), this.names.length - 1)]);
  }
}

function describe({ trust, events, confirmed }) {
  const words = [trust === null ? "trust unknown" : `trust ${trust.toFixed(2)}`];
  if (events) words.push(`${confirmed ? "✓ " : ""}${events} ${events === 1 ? "event" : "events"}`);
  return words.join(" · ");
}
