// The correction page: images, keys and tools. Corrections are sent to the server as events.

import { Stage } from "/static/canvas.js";
import { Outbox, Refusal, request } from "/static/client.js";
import { buildControls, mark, onKeys } from "/static/controls.js";
import { ImageList } from "/static/list.js";
import { Tools } from "/static/tools.js";

const by = (id) => document.getElementById(id);
const LABELS = ["road", "not_road", "void", "sky", "vertical", "horizontal"];
const TOOLS = { superpixel: "s", polygon: "p", brush: "b" };
const IDLE = 30; // seconds without a key or pointer event that do not count as work
const POLL = 1500; // milliseconds

const stage = new Stage(by("stage"));
const list = new ImageList(by("list"), open);
const tools = new Tools(stage, send, () => current !== null);
const outbox = new Outbox(acknowledged);
const loaded = new Map(); // images by name: promises, the last few

let images = []; // the server's list; an open page keeps its order
let listing = []; // the same, in the server's latest order
let stamp = ""; // its version
let trainCommand = ""; // trains on the corrections
let current = null; // the open image
let state = null; // its last state from the server
let seconds = 0; // working time since the last event
let lastInput = performance.now();
let requested = null; // name of the image that was requested last

// --- images -----------------------------------------------------------------------------

function load(name) {
  if (!loaded.has(name)) {
    const bitmap = request("image", { name }).then((answer) => answer.blob()).then(createImageBitmap);
    const superpixels = request("superpixels", { name }).then((answer) => answer.arrayBuffer());
    loaded.set(name, Promise.all([bitmap, superpixels]));
    loaded.get(name).catch(() => loaded.delete(name));
    if (loaded.size > 4) loaded.delete(loaded.keys().next().value);
  }
  return loaded.get(name);
}

async function open(name) {
  requested = name;
  document.body.classList.remove("listing");
  by("waiting").hidden = false;
  try {
    const [[bitmap, superpixels], answer] = await Promise.all([load(name), request("state", { name })]);
    const opened = await answer.json();
    if (requested !== name) return;
    const { size, shape } = opened;
    current = { name, bitmap, superpixels: new Uint16Array(superpixels), size, shape };
    seconds = 0;
    notice("");
    location.hash = encodeURIComponent(name);
    localStorage.roadtorchLast = name;
    images = listing;
    list.show(images, name);
    show(opened);
    list.reveal();
    load(following()).catch(() => {});
  } catch (error) {
    if (requested === name) failed(error);
  } finally {
    if (requested === name) by("waiting").hidden = true;
  }
}

function following(step = 1) {
  const isCurrent = (image) => image.name === current?.name;
  const open = images.filter((image) => !image.confirmed || isCurrent(image));
  if (open.length > 1 && step > 0) return open[(open.findIndex(isCurrent) + 1) % open.length].name;
  return images.at((images.findIndex(isCurrent) + step) % images.length)?.name;
}

// --- state from the server --------------------------------------------------------------

function show(answer) {
  state = answer;
  const { name, trust, clicks } = state;
  stage.show(current, Uint8Array.from(atob(state.layers), (letter) => letter.charCodeAt(0)));
  stage.pending = waiting();
  by("name").textContent = name;
  document.title = `${name} · roadtorch`;
  const facts = [
    state.confirmed ? "confirmed ✓" : "", trust === null ? "" : `trust ${trust.toFixed(2)}`,
    `${clicks} ${clicks === 1 ? "click" : "clicks"}`, `${Math.round(state.seconds)} s`,
  ];
  by("facts").textContent = facts.filter(Boolean).join(" · ");
  document.body.dataset.version = state.version;
  document.body.dataset.image = name;
  by("undo").disabled = !state.events.length;
  by("redo").disabled = !state.redo.length;
}

// Events on the open image that the server has not acknowledged.
function waiting() {
  return outbox.waiting.filter(({ name }) => name === current.name).map(({ event }) => event);
}

function acknowledged(entry, answer, error) {
  notice(error ? `Not saved: ${error.message}` : "");
  if (answer && current?.name === entry.name) show(answer);
  else if (current) {
    stage.pending = stage.pending.filter((event) => event.id !== entry.event.id);
    stage.draw();
  }
}

function notice(text) {
  if (by("notice").textContent === text) return;
  by("notice").textContent = text;
  by("notice").hidden = !text;
}

function failed(error) {
  if (error instanceof Refusal) return notice(error.message);
  const count = outbox.waiting.length;
  const unsent = count ? ` (${count} unsent ${count === 1 ? "event" : "events"})` : "";
  notice(`No answer from the server${unsent}. Start roadtorch annotate again; nothing is lost.`);
}

async function refresh() {
  try {
    if (outbox.waiting.length) await outbox.send();
    const answer = await request("images", { stamp });
    if (by("notice").textContent.startsWith("No answer")) notice("");
    if (answer.status === 204) return;
    const { folder, ...latest } = await answer.json();
    if (outbox.folder && outbox.folder !== folder) return location.reload();
    outbox.folder = folder;
    ({ stamp, train_command: trainCommand, images: listing } = latest);
    await update();
  } catch (error) {
    failed(error);
  }
}

// Keep the old order, which changes only when an image is opened: no row jumps away.
async function update() {
  const order = new Map(images.map(({ name }, index) => [name, index]));
  const position = ({ name }) => order.get(name) ?? images.length;
  images = listing.toSorted((a, b) => position(a) - position(b));
  list.show(images, current?.name);
  const confirmed = images.filter((image) => image.confirmed).length;
  const detected = images.filter((image) => image.trust !== null).length;
  const progress = detected < images.length ? `, ${detected} detected` : "";
  by("progress").textContent = `${confirmed} of ${images.length} confirmed${progress}`;
  if (!images.length) notice("The folder holds no images.");
  const name = current?.name;
  const listed = images.find((image) => image.name === name);
  if (name && !listed) notice(`${name} is no longer in the folder.`);
  if (!listed || !state || outbox.waiting.length || listed.version <= state.version) return;
  const changed = await (await request("state", { name })).json(); // by another window
  if (current.name === name) show(changed);
}

// --- events -----------------------------------------------------------------------------

function countTime() {
  const now = performance.now();
  const gap = (now - lastInput) / 1000;
  if (gap < IDLE) seconds += gap;
  lastInput = now;
}

function send(event) {
  if (!current) return Promise.resolve();
  countTime();
  const timed = { ...event, seconds: Math.min(Math.round(seconds * 10) / 10, 600) };
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

async function confirm() {
  if (stage.polygon.length) return tools.closePolygon();
  if (!current) return;
  const { name } = current;
  const next = following();
  const last = images.every((image) => image.confirmed || image.name === name);
  await send({ kind: "confirm" });
  if (last) notice(`All ${images.length} images are confirmed. To train on them: ${trainCommand}`);
  else if (next !== name) open(next);
}

function go(step) {
  const name = following(step);
  if (name) open(name);
}

// --- overlay ----------------------------------------------------------------------------

function fade(opacity) {
  stage.opacity = Math.min(1, Math.max(0.05, opacity));
  by("opacity").value = stage.opacity;
  stage.draw();
}

function flip(name) {
  stage[name] = !stage[name];
  stage.draw();
}

function switchLayer() {
  stage.layer = stage.layer === "road" ? "layout" : "road";
  if (current) stage.tint();
  stage.draw();
}

// --- making the page --------------------------------------------------------------------

function chooseTool(tool) {
  tools.choose(tool);
  mark("tools", tool);
}

function chooseLabel(label) {
  tools.label = label;
  mark("labels", label);
}

function showList() {
  document.body.classList.toggle("listing");
  by("list").focus();
}

// Key, description, action; for a button its group, text and name.
const CONTROLS = [
  ...LABELS.map((label, index) => {
    const words = label.replace("_", " ");
    return [`${index + 1}`, `label ${words}`, () => chooseLabel(label), "labels", words, label];
  }),
  ...Object.entries(TOOLS).map(([tool, key]) => [
    key, `${tool} tool`, () => chooseTool(tool), "tools", tool, tool,
  ]),
  ["Enter", "confirm the image and open the next; closes a polygon", confirm, "actions", "confirm"],
  ["z", "undo (or Ctrl+Z)", undo, "actions", "undo", "undo"],
  ["y", "redo (or Ctrl+Y)", redo, "actions", "redo", "redo"],
  ["n", "next unconfirmed image", () => go(1), "actions", "next"],
  ["k", "previous image in the list", () => go(-1)],
  [" ", "click at the cursor", () => tools.click()],
  ["Escape", "discard the polygon", () => tools.discard()],
  ["-", "zoom out", () => stage.zoomBy(0.8), "view", "−"],
  ["+", "zoom in", () => stage.zoomBy(1.25), "view", "+"],
  ["0", "whole image", () => stage.fit(), "view", "whole"],
  ["[", "smaller brush", () => tools.resize(1 / 1.3)],
  ["]", "larger brush", () => tools.resize(1.3)],
  ["o", "fainter overlay", () => fade(stage.opacity - 0.1)],
  ["O", "stronger overlay", () => fade(stage.opacity + 0.1)],
  ["v", "show or hide the overlay", () => flip("hidden")],
  ["g", "show or hide superpixel borders", () => flip("borders")],
  ["l", "show road or layout", switchLayer, "view", "road / layout"],
  ["m", "list of images (arrow keys select)", showList],
  ["?", "list of keys", () => by("help").showModal()],
];

function listen() {
  addEventListener("keydown", countTime);
  addEventListener("pointermove", countTime);
  onKeys(CONTROLS, (x, y, event) => {
    if (event.ctrlKey) stage.pan(-40 * x, -40 * y);
    else tools.nudge(x, y, event.shiftKey);
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

// Open the image in the URL, or the last one, or the first of the list.
async function resume() {
  if (requested || !images.length) return;
  const last = [decodeURIComponent(location.hash.slice(1)), localStorage.roadtorchLast];
  const listed = last.find((name) => images.some((image) => image.name === name));
  await open(listed ?? images[0].name);
}

async function poll() {
  await refresh();
  await resume();
  setTimeout(poll, POLL);
}

buildControls(CONTROLS);
listen();
chooseLabel("road");
chooseTool("superpixel");
poll();
