// Buttons, keys and their help, built from CONTROLS in annotate.js.

const by = (id) => document.getElementById(id);
const element = (tag, properties) => Object.assign(document.createElement(tag), properties);

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

const ARROW_WORDS = "move the cursor; Shift: by one pixel; Ctrl: move the image";

export function buildControls(controls) {
  for (const control of [...controls, ["arrows", ARROW_WORDS]]) {
    const [key, words, , group] = control;
    const label = element("kbd", { textContent: key === " " ? "Space" : key });
    by("keys").append(label, element("span", { textContent: words }));
    if (group) by(group).append(button(...control));
  }
}

// name: value of a radio button, id of any other.
function button(key, words, act, group, text, name = "") {
  const node = element("button", { type: "button", title: words });
  if (by(group).role === "radiogroup") {
    node.role = "radio";
    node.dataset.value = name;
  } else if (name) node.id = name;
  if (group === "labels") node.append(element("i", { className: name }));
  node.append(text, element("kbd", { textContent: key === "Enter" ? "⏎" : key }));
  node.addEventListener("click", () => {
    act();
    node.blur();
  });
  return node;
}

export function mark(group, value) {
  for (const radio of by(group).children) radio.ariaChecked = radio.dataset.value === value;
}

// Bind keys to their actions. arrow(x, y, event): action of the arrow keys.
export function onKeys(controls, arrow) {
  addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]") || event.target.tagName === "INPUT") return;
    if (ARROWS[event.key]) {
      event.preventDefault();
      return arrow(...ARROWS[event.key], event);
    }
    const isControl = event.ctrlKey || event.metaKey;
    const history = isControl && { z: "z", Z: "y", y: "y" }[event.key];
    if ((isControl || event.altKey) && !history) return;
    // A dialog's button keeps the focus for a frame after the dialog is closed.
    const pressed = event.target.tagName === "BUTTON" && event.target.checkVisibility();
    const onButton = pressed && [" ", "Enter"].includes(event.key);
    const control = controls.find(([name]) => name === (history || event.key));
    if (!control || onButton) return;
    event.preventDefault();
    control[2]();
  });
}
