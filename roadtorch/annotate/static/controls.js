// Buttons and keys: what can be done, in one table each.

const by = (id) => document.getElementById(id);

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

export const ARROW_WORDS = "move the cross; Shift: by one pixel; Ctrl: move the picture";

// A button of a group, which has its key in small letters. value: of one of several to choose from.
export function button(group, text, key, act, value = "") {
  const made = document.createElement("button");
  made.type = "button";
  made.dataset.value = value;
  if (group === "sayings") {
    made.append(Object.assign(document.createElement("i"), { className: value }));
  }
  made.append(text, Object.assign(document.createElement("kbd"), { textContent: key }));
  made.addEventListener("click", () => {
    act();
    made.blur();
  });
  if (value) made.setAttribute("role", "radio");
  by(group).append(made);
  return made;
}

export function marked(group, value) {
  for (const one of by(group).children) {
    one.setAttribute("aria-checked", one.dataset.value === value);
  }
}

// keys: [key, what it does in words, what it does].
export function listKeys(keys) {
  const rows = keys.map(([key, words]) => [key === " " ? "Space" : key, words]);
  for (const [key, words] of [...rows, ["arrows", ARROW_WORDS]]) {
    by("keys").append(
      Object.assign(document.createElement("kbd"), { textContent: key }),
      Object.assign(document.createElement("span"), { textContent: words }),
    );
  }
}

// Do what a key says. arrow(x, y, event): what the arrow keys do.
export function onKeys(keys, arrow) {
  addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]") || event.target.tagName === "INPUT") return;
    if (ARROWS[event.key]) {
      event.preventDefault();
      return arrow(...ARROWS[event.key], event);
    }
    const held = event.ctrlKey || event.metaKey;
    const history = held && { z: "z", Z: "y", y: "y" }[event.key];
    if ((held || event.altKey) && !history) return;
    // A dialog's button keeps the focus for a frame after the dialog is closed.
    const pressed = event.target.tagName === "BUTTON" && event.target.checkVisibility();
    const onButton = pressed && [" ", "Enter"].includes(event.key);
    const found = keys.find(([name]) => name === (history || event.key));
    if (!found || onButton) return;
    event.preventDefault();
    found[2]();
  });
}
