// Buttons, keys and their help, made of one table: see CONTROLS in annotate.js.

const by = (id) => document.getElementById(id);
const element = (tag, properties) => Object.assign(document.createElement(tag), properties);

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const ARROW_WORDS = "move the cross; Shift: by one pixel; Ctrl: move the image";

export function buildControls(controls) {
  for (const control of [...controls, ["arrows", ARROW_WORDS]]) {
    const [key, words, , group] = control;
    const shown = element("kbd", { textContent: key === " " ? "Space" : key });
    by("keys").append(shown, element("span", { textContent: words }));
    if (group) by(group).append(button(...control));
  }
}

// name: in a group of which one is chosen the button's value, else its id.
function button(key, words, act, group, text, name = "") {
  const made = element("button", { type: "button", title: words });
  if (by(group).role === "radiogroup") {
    made.role = "radio";
    made.dataset.value = name;
  } else if (name) made.id = name;
  if (group === "sayings") made.append(element("i", { className: name }));
  made.append(text, element("kbd", { textContent: key === "Enter" ? "⏎" : key }));
  made.addEventListener("click", () => {
    act();
    made.blur();
  });
  return made;
}

export function mark(group, value) {
  for (const one of by(group).children) one.ariaChecked = one.dataset.value === value;
}

// Do what a key says. arrow(x, y, event): what the arrow keys do.
export function onKeys(controls, arrow) {
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
    const found = controls.find(([name]) => name === (history || event.key));
    if (!found || onButton) return;
    event.preventDefault();
    found[2]();
  });
}
