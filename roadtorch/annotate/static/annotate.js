// The page: images, keys and tools; what they do goes to the server as events.

import { Stage } from "/static/canvas.js";
import { buildControls, mark, onKeys } from "/static/controls.js";
import { Hand } from "/static/hand.js";
import { Outbox, Refusal, ask } from "/static/link.js";
import { ImageList } from "/static/list.js";

const by = (id) => document.getElementById(id);
const SAYINGS = ["road", "not_road", "void", "sky", "vertical", "horizontal"];
const TOOLS = { superpixel: "s", polygon: "p", brush: "b" };
const IDLE = 30; // seconds without a hand on keys or pointer that count as no work
const POLL = 1500; // milliseconds

const stage = new Stage(by("stage"));
const list = new ImageList(by("list"), open);
const hand = new Hand(stage, send, () => current !== null);
const outbox = new Outbox(acted);
const loaded = new Map(); // images by name: promises, the last few

let images = []; // what the server lists, in the order of the page
let stamp = "";
let learn = ""; // the command that learns from the corrections
let current = null; // the image that is shown
let state = null; // what the server last answered about it
let seconds = 0; // at work since the last act
let touched = performance.now();
let wanted = null; // the image that was asked for last

// --- images -----------------------------------------------------------------------------

function load(name) {
  if (!loaded.has(name)) {
    const bitmap = ask("image", { name }).then((answer) => answer.blob()).then(createImageBitmap);
    const superpixels = ask("superpixels", { name }).then((answer) => answer.arrayBuffer());
    loaded.set(name, Promise.all([bitmap, superpixels]));
    loaded.get(name).catch(() => loaded.delete(name));
    if (loaded.size > 4) loaded.delete(loaded.keys().next().value);
  }
  return loaded.get(name);
}

async function open(name) {
  wanted = name;
  document.body.classList.remove("listing");
  by("waiting").hidden = false;
  try {
    const [[bitmap, superpixels], answer] = await Promise.all([load(name), ask("state", { name })]);
    const found = await answer.json();
    if (wanted !== name) return;
    const { size, shape } = found;
    current = { name, bitmap, superpixels: new Uint16Array(superpixels), size, shape };
    seconds = 0;
    notice("");
    location.hash = encodeURIComponent(name);
    localStorage.roadtorchLast = name;
    sort();
    show(found);
    list.reveal();
    load(following()).catch(() => {});
  } catch (problem) {
    if (wanted === name) failed(problem);
  } finally {
    if (wanted === name) by("waiting").hidden = true;
  }
}

// Those that are not confirmed come first: with a turn, then the least certain, then unknown ones.
function sort() {
  const key = (image) => [image.confirmed ? 1 : 0, image.turn ?? 1e9, image.trust ?? 2];
  images.sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    return x[0] - y[0] || x[1] - y[1] || x[2] - y[2] || (a.name < b.name ? -1 : 1);
  });
  list.show(images, current?.name);
}

function following(step = 1) {
  const shown = (image) => image.name === current?.name;
  const open = images.filter((image) => !image.confirmed || shown(image));
  if (open.length > 1 && step > 0) return open[(open.findIndex(shown) + 1) % open.length].name;
  return images.at((images.findIndex(shown) + step) % images.length)?.name;
}

// --- what the server answers ------------------------------------------------------------

function show(found) {
  state = found;
  stage.show(current, Uint8Array.from(atob(found.layers), (letter) => letter.charCodeAt(0)));
  stage.pending = waiting();
  by("name").textContent = found.name;
  document.title = `${found.name} · roadtorch`;
  const facts = [
    found.confirmed ? "right ✓" : "",
    found.trust === null ? "" : `trust ${found.trust.toFixed(2)}`,
    `${found.clicks} ${found.clicks === 1 ? "click" : "clicks"}`, `${Math.round(found.seconds)} s`,
  ];
  by("facts").textContent = facts.filter(Boolean).join(" · ");
  document.body.dataset.version = found.version;
  document.body.dataset.image = found.name;
  by("undo").disabled = !found.events.length;
  by("redo").disabled = !found.redo.length;
}

// The acts on the shown image that the server has not acknowledged.
function waiting() {
  return outbox.waiting.filter(({ name }) => name === current.name).map(({ act }) => act);
}

function acted(entry, found, problem) {
  notice(problem ? `Not kept: ${problem.message}` : "");
  if (found && current?.name === entry.name) show(found);
  else if (current) {
    stage.pending = stage.pending.filter((act) => act.id !== entry.act.id);
    stage.draw();
  }
}

function notice(text) {
  if (by("notice").textContent === text) return;
  by("notice").textContent = text;
  by("notice").hidden = !text;
}

function failed(problem) {
  if (problem instanceof Refusal) return notice(problem.message);
  const count = outbox.waiting.length;
  const kept = count ? `; ${count} ${count === 1 ? "event waits" : "events wait"} here` : "";
  notice(`No answer from the server${kept}. Start roadtorch annotate again: this page goes on.`);
}

async function refresh() {
  try {
    if (outbox.waiting.length) await outbox.send();
    const answer = await ask("images", { stamp });
    if (by("notice").textContent.startsWith("No answer")) notice("");
    if (answer.status === 204) return;
    const found = await answer.json();
    ({ stamp, learn } = found);
    await update(found.images);
  } catch (problem) {
    failed(problem);
  }
}

// A new list: the order stays until the next image is opened, so that no row jumps away.
async function update(found) {
  const order = new Map(images.map(({ name }, index) => [name, index]));
  const place = ({ name }) => order.get(name) ?? images.length;
  const first = !images.length;
  images = found.sort((a, b) => place(a) - place(b));
  if (first) sort();
  else list.show(images, current?.name);
  const right = images.filter((image) => image.confirmed).length;
  const known = images.filter((image) => image.trust !== null).length;
  const looked = known < images.length ? `, ${known} looked at` : "";
  by("progress").textContent = `${right} of ${images.length} right${looked}`;
  if (!images.length) notice("The folder holds no images.");
  const name = current?.name;
  const listed = images.find((image) => image.name === name);
  if (name && !listed) notice(`${name} is no longer in the folder.`);
  if (!listed || !state || outbox.waiting.length || listed.version <= state.version) return;
  const changed = await (await ask("state", { name })).json(); // in another window
  if (current.name === name) show(changed);
}

// --- acts -------------------------------------------------------------------------------

function work() {
  const now = performance.now();
  const gap = (now - touched) / 1000;
  if (gap < IDLE) seconds += gap;
  touched = now;
}

function send(act) {
  if (!current) return Promise.resolve();
  work();
  const timed = { ...act, seconds: Math.min(Math.round(seconds * 10) / 10, 600) };
  seconds = 0;
  const sent = outbox.add(current.name, timed).catch(failed);
  stage.pending = waiting();
  stage.draw();
  return sent;
}

function undo() {
  if (stage.polygon.length) {
    stage.polygon.pop();
    return stage.draw();
  }
  if (state?.events.length) send({ kind: "undo", of: state.events.at(-1) });
}

function redo() {
  if (state?.redo.length) send({ kind: "redo", of: state.redo.at(-1) });
}

async function right() {
  if (stage.polygon.length) return hand.closePolygon();
  if (!current) return;
  const { name } = current;
  const next = following();
  const last = images.every((image) => image.confirmed || image.name === name);
  await send({ kind: "right" });
  if (last) notice(`All done: ${images.length} of ${images.length} right. To learn from them: ${learn}`);
  else if (next !== name) open(next);
}

function go(step) {
  const name = following(step);
  if (name) open(name);
}

// --- sight ------------------------------------------------------------------------------

function fade(opacity) {
  stage.opacity = Math.min(1, Math.max(0.05, opacity));
  by("opacity").value = stage.opacity;
  stage.draw();
}

function flip(name) {
  stage[name] = !stage[name];
  stage.draw();
}

function sight() {
  stage.sight = stage.sight === "road" ? "layout" : "road";
  if (current) stage.tint();
  stage.draw();
}

// --- making the page --------------------------------------------------------------------

function choose(tool) {
  hand.choose(tool);
  mark("tools", tool);
}

function say(saying) {
  hand.saying = saying;
  mark("sayings", saying);
}

function toList() {
  document.body.classList.toggle("listing");
  by("list").focus();
}

// Key, what it does in words, what it does; for a button its group, its text and its name.
const CONTROLS = [
  ...SAYINGS.map((saying, index) => {
    const words = saying.replace("_", " ");
    return [`${index + 1}`, `say ${words}`, () => say(saying), "sayings", words, saying];
  }),
  ...Object.entries(TOOLS).map(([tool, key]) => [
    key, `${tool} tool`, () => choose(tool), "tools", tool, tool,
  ]),
  ["Enter", "right as it is, and on to the next; closes a polygon", right, "acts", "right as it is"],
  ["z", "undo (Ctrl+Z as well)", undo, "acts", "undo", "undo"],
  ["y", "redo (Ctrl+Y as well)", redo, "acts", "redo", "redo"],
  ["n", "next image, the least certain that waits", () => go(1), "acts", "next"],
  ["k", "image before it in the list", () => go(-1)],
  [" ", "click at the cross", () => hand.click()],
  ["Escape", "drop the polygon", () => hand.drop()],
  ["-", "zoom out", () => stage.zoomBy(0.8), "sight", "−"],
  ["+", "zoom in", () => stage.zoomBy(1.25), "sight", "+"],
  ["0", "whole image", () => stage.fit(), "sight", "whole"],
  ["[", "smaller brush", () => hand.resize(1 / 1.3)],
  ["]", "larger brush", () => hand.resize(1.3)],
  ["o", "fainter overlay", () => fade(stage.opacity - 0.1)],
  ["O", "stronger overlay", () => fade(stage.opacity + 0.1)],
  ["v", "overlay on and off", () => flip("hidden")],
  ["g", "borders of superpixels on and off", () => flip("borders")],
  ["l", "see road or layout", sight, "sight", "road / layout"],
  ["m", "list of images (arrows move in it)", toList],
  ["?", "these keys", () => by("help").showModal()],
];

function listen() {
  addEventListener("keydown", work);
  addEventListener("pointermove", work);
  onKeys(CONTROLS, (x, y, event) => {
    if (event.ctrlKey) stage.pan(-40 * x, -40 * y);
    else hand.nudge(x, y, event.shiftKey);
  });
  by("opacity").addEventListener("input", () => fade(Number(by("opacity").value)));
  by("show-list").addEventListener("click", () => document.body.classList.toggle("listing"));
  by("help-button").addEventListener("click", () => by("help").showModal());
  by("hint").hidden = localStorage.roadtorchHint === "seen";
  by("hint-seen").addEventListener("click", () => {
    localStorage.roadtorchHint = "seen";
    by("hint").hidden = true;
  });
}

// Open the image of the address, or the last one, or the least certain.
async function resume() {
  if (wanted || !images.length) return;
  const last = [decodeURIComponent(location.hash.slice(1)), localStorage.roadtorchLast];
  const known = last.find((name) => images.some((image) => image.name === name));
  await open(known ?? (images.find((image) => !image.confirmed) ?? images[0]).name);
}

async function poll() {
  await refresh();
  await resume();
  setTimeout(poll, POLL);
}

buildControls(CONTROLS);
listen();
say("road");
choose("superpixel");
poll();
