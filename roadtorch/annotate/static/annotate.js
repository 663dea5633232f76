// The correction page: images, keys and tools. Corrections are sent to the server as events.

import { Stage } from "/static/canvas.js";
import { buildControls, mark, onKeys } from "/static/controls.js";
import { Hand } from "/static/hand.js";
import { Outbox, Refusal, ask } from "/static/link.js";
import { ImageList } from "/static/list.js";

const by = (id) => document.getElementById(id);
const SAYINGS = ["road", "not_road", "void", "sky", "vertical", "horizontal"];
const TOOLS = { superpixel: "s", polygon: "p", brush: "b" };
const IDLE = 30; // seconds without a key or pointer event that do not count as work
const POLL = 1500; // milliseconds

const stage = new Stage(by("stage"));
const list = new ImageList(by("list"), open);
const hand = new Hand(stage, send, () => current !== null);
const outbox = new Outbox(acted);
const loaded = new Map(); // images by name: promises, the last few

let images = []; // the server's list, in the order of the page
let stamp = ""; // its version
let learn = ""; // the command that trains on the corrections
let current = null; // the open image
let state = null; // its last state from the server
let seconds = 0; // of work since the last event
let touched = performance.now();
let requested = null; // name of the image that was requested last

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
  requested = name;
  document.body.classList.remove("listing");
  by("waiting").hidden = false;
  try {
    const [[bitmap, superpixels], answer] = await Promise.all([load(name), ask("state", { name })]);
    const opened = await answer.json();
    if (requested !== name) return;
    const { size, shape } = opened;
    current = { name, bitmap, superpixels: new Uint16Array(superpixels), size, shape };
    seconds = 0;
    notice("");
    location.hash = encodeURIComponent(name);
    localStorage.roadtorchLast = name;
    sort();
    show(opened);
    list.reveal();
    load(following()).catch(() => {});
  } catch (error) {
    if (requested === name) failed(error);
  } finally {
    if (requested === name) by("waiting").hidden = true;
  }
}

// Unconfirmed images first: by turn, then by trust, then those of unknown trust.
function sort() {
  const key = (image) => [image.confirmed ? 1 : 0, image.turn ?? 1e9, image.trust ?? 2];
  images.sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    return x[0] - y[0] || x[1] - y[1] || x[2] - y[2] || (a.name < b.name ? -1 : 1);
  });
  list.show(images, current?.name);
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
  return outbox.waiting.filter(({ name }) => name === current.name).map(({ act }) => act);
}

function acted(entry, answer, error) {
  notice(error ? `Not saved: ${error.message}` : "");
  if (answer && current?.name === entry.name) show(answer);
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

function failed(error) {
  if (error instanceof Refusal) return notice(error.message);
  const count = outbox.waiting.length;
  const unsent = count ? ` (${count} unsent ${count === 1 ? "event" : "events"})` : "";
  notice(`No answer from the server${unsent}. Start roadtorch annotate again; nothing is lost.`);
}

async function refresh() {
  try {
    if (outbox.waiting.length) await outbox.send();
    const answer = await ask("images", { stamp });
    if (by("notice").textContent.startsWith("No answer")) notice("");
    if (answer.status === 204) return;
    const listing = await answer.json();
    if (outbox.folder && outbox.folder !== listing.folder) return location.reload();
    outbox.folder = listing.folder;
    ({ stamp, learn } = listing);
    await update(listing.images);
  } catch (error) {
    failed(error);
  }
}

// Take a new list in the old order, which changes only when an image is opened: no row jumps away.
async function update(listing) {
  const order = new Map(images.map(({ name }, index) => [name, index]));
  const position = ({ name }) => order.get(name) ?? images.length;
  const first = !images.length;
  images = listing.sort((a, b) => position(a) - position(b));
  if (first) sort();
  else list.show(images, current?.name);
  const confirmed = images.filter((image) => image.confirmed).length;
  const detected = images.filter((image) => image.trust !== null).length;
  const progress = detected < images.length ? `, ${detected} detected` : "";
  by("progress").textContent = `${confirmed} of ${images.length} confirmed${progress}`;
  if (!images.length) notice("The folder holds no images.");
  const name = current?.name;
  const listed = images.find((image) => image.name === name);
  if (name && !listed) notice(`${name} is no longer in the folder.`);
  if (!listed || !state || outbox.waiting.length || listed.version <= state.version) return;
  const changed = await (await ask("state", { name })).json(); // by another window
  if (current.name === name) show(changed);
}

// --- events -----------------------------------------------------------------------------

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

async function confirm() {
  if (stage.polygon.length) return hand.closePolygon();
  if (!current) return;
  const { name } = current;
  const next = following();
  const last = images.every((image) => image.confirmed || image.name === name);
  await send({ kind: "right" });
  if (last) notice(`All ${images.length} images are confirmed. To train on them: ${learn}`);
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

// Key, description, action; for a button its group, text and name.
const CONTROLS = [
  ...SAYINGS.map((saying, index) => {
    const words = saying.replace("_", " ");
    return [`${index + 1}`, `label ${words}`, () => say(saying), "sayings", words, saying];
  }),
  ...Object.entries(TOOLS).map(([tool, key]) => [
    key, `${tool} tool`, () => choose(tool), "tools", tool, tool,
  ]),
  ["Enter", "confirm the image and open the next; closes a polygon", confirm, "acts", "confirm"],
  ["z", "undo (or Ctrl+Z)", undo, "acts", "undo", "undo"],
  ["y", "redo (or Ctrl+Y)", redo, "acts", "redo", "redo"],
  ["n", "next unconfirmed image", () => go(1), "acts", "next"],
  ["k", "previous image in the list", () => go(-1)],
  [" ", "click at the cursor", () => hand.click()],
  ["Escape", "discard the polygon", () => hand.drop()],
  ["-", "zoom out", () => stage.zoomBy(0.8), "sight", "−"],
  ["+", "zoom in", () => stage.zoomBy(1.25), "sight", "+"],
  ["0", "whole image", () => stage.fit(), "sight", "whole"],
  ["[", "smaller brush", () => hand.resize(1 / 1.3)],
  ["]", "larger brush", () => hand.resize(1.3)],
  ["o", "fainter overlay", () => fade(stage.opacity - 0.1)],
  ["O", "stronger overlay", () => fade(stage.opacity + 0.1)],
  ["v", "show or hide the overlay", () => flip("hidden")],
  ["g", "show or hide superpixel borders", () => flip("borders")],
  ["l", "show road or layout", sight, "sight", "road / layout"],
  ["m", "list of images (arrow keys select)", toList],
  ["?", "list of keys", () => by("help").showModal()],
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

// Open the image in the URL, or the last one, or the least trusted.
async function resume() {
  if (requested || !images.length) return;
  const last = [decodeURIComponent(location.hash.slice(1)), localStorage.roadtorchLast];
  const listed = last.find((name) => images.some((image) => image.name === name));
  await open(listed ?? (images.find((image) => !image.confirmed) ?? images[0]).name);
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
