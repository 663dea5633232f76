// The page: pictures, keys and tools; what they do goes to the server as events.

import { ROADS, Stage } from "/static/canvas.js";
import { button, listKeys, marked, onKeys } from "/static/controls.js";
import { Hand } from "/static/hand.js";
import { Outbox, Refusal, ask } from "/static/link.js";
import { PictureList } from "/static/list.js";

const by = (id) => document.getElementById(id);
const SAYINGS = ["road", "not_road", "void", "sky", "vertical", "horizontal"];
const TOOLS = { superpixel: "s", polygon: "p", brush: "b" };
const IDLE = 30; // seconds without a hand on keys or pointer that count as no work
const POLL = 1500; // milliseconds

const stage = new Stage(by("stage"));
const list = new PictureList(by("list"), by("spacer"), open);
const hand = new Hand(stage, send, () => current !== null);
const outbox = new Outbox(acted);
const loaded = new Map(); // pictures by name: promises, the last few

let pictures = [];
let stamp = "";
let learn = ""; // the command that learns from the corrections
let current = null; // the picture that is shown
let state = null; // what the server told about it
let seconds = 0; // at work since the last act
let touched = performance.now();
let wanted = null; // the picture that was asked for last

// --- pictures ---------------------------------------------------------------------------

function picture(name) {
  if (!loaded.has(name)) {
    loaded.set(name, Promise.all([bitmap(name), superpixels(name)]));
    loaded.get(name).catch(() => loaded.delete(name));
    if (loaded.size > 4) loaded.delete(loaded.keys().next().value);
  }
  return loaded.get(name);
}

async function bitmap(name) {
  return createImageBitmap(await (await ask("picture", { name })).blob());
}

async function superpixels(name) {
  return new Uint16Array(await (await ask("superpixels", { name })).arrayBuffer());
}

async function open(name) {
  wanted = name;
  document.body.classList.remove("listing");
  by("waiting").hidden = false;
  try {
    const [[image, labels], found] = await Promise.all([
      picture(name), ask("state", { name }).then((answer) => answer.json()),
    ]);
    if (wanted !== name) return;
    const { size, shape } = found;
    current = { name, bitmap: image, superpixels: labels, size, shape };
    seconds = 0;
    notice("");
    location.hash = encodeURIComponent(name);
    localStorage.roadtorchLast = name;
    sorted();
    tell(found);
    list.reveal();
    preload();
  } catch (problem) {
    if (wanted === name) failed(problem);
  } finally {
    if (wanted === name) by("waiting").hidden = true;
  }
}

// The pictures that wait for a verdict: those with a turn, then the least certain first; unknown
// ones at the end.
function sorted() {
  const key = (one) => [one.confirmed ? 1 : 0, one.turn ?? 1e9, one.trust ?? 2];
  pictures.sort((a, b) => {
    const [x, y] = [key(a), key(b)];
    return x[0] - y[0] || x[1] - y[1] || x[2] - y[2] || (a.name < b.name ? -1 : 1);
  });
  list.show(pictures, current?.name ?? null);
}

function following(step = 1) {
  const index = pictures.findIndex((one) => one.name === current?.name);
  const open = pictures.filter((one) => !one.confirmed || one.name === current?.name);
  const place = open.findIndex((one) => one.name === current?.name);
  if (open.length > 1 && step > 0) return open[(place + 1) % open.length].name;
  return pictures[(index + step + pictures.length) % pictures.length]?.name;
}

function preload() {
  const name = following();
  if (name && name !== current?.name) picture(name).catch(() => {});
}

function unpacked(text) {
  return Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
}

// --- what the server tells --------------------------------------------------------------

function tell(found) {
  state = found;
  stage.show(current, unpacked(found.layers));
  stage.pending = outbox.waiting.filter((e) => e.name === current.name).map((e) => e.act);
  by("name").textContent = found.name;
  document.title = `${found.name} · roadtorch`;
  const facts = [
    found.confirmed ? "right ✓" : "",
    found.trust === null ? "" : `trust ${found.trust.toFixed(2)}`,
    `${found.clicks} ${found.clicks === 1 ? "click" : "clicks"}`, `${Math.round(found.seconds)} s`,
  ];
  by("facts").textContent = facts.filter(Boolean).join(" · ");
  document.body.dataset.version = found.version;
  document.body.dataset.picture = found.name;
  for (const button of document.querySelectorAll("[data-act]")) {
    if (button.dataset.act === "undo") button.disabled = !found.events.length;
    if (button.dataset.act === "redo") button.disabled = !found.redo.length;
  }
}

function acted(entry, found, problem) {
  if (problem) notice(`Not kept: ${problem.message}`);
  else notice("");
  if (found && current?.name === entry.name) tell(found);
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
    const answer = await ask("pictures", { stamp });
    if (by("notice").textContent.startsWith("No answer")) notice("");
    if (answer.status === 204) return;
    const found = await answer.json();
    stamp = found.stamp;
    learn = found.learn;
    await listed(found.pictures);
  } catch (problem) {
    failed(problem);
  }
}

// A new list: the order stays until the next picture is opened, so that no row jumps away.
async function listed(found) {
  const order = new Map(pictures.map((one, index) => [one.name, index]));
  const place = (one) => order.get(one.name) ?? Infinity;
  const first = !pictures.length;
  pictures = found.sort((a, b) => (place(a) === place(b) ? 0 : place(a) - place(b)));
  if (first) sorted();
  else list.show(pictures, current?.name ?? null);
  const right = pictures.filter((one) => one.confirmed).length;
  const known = pictures.filter((one) => one.trust !== null).length;
  const looked = known < pictures.length ? `, ${known} looked at` : "";
  by("progress").textContent = `${right} of ${pictures.length} right${looked}`;
  if (!pictures.length) notice("The folder holds no pictures.");
  const own = pictures.find((one) => one.name === current?.name);
  if (current && !own) notice(`${current.name} is no longer in the folder.`);
  const version = own?.version ?? 0;
  if (own && state && !outbox.waiting.length && version > state.version) await again();
}

// Another window did something: show it.
async function again() {
  const { name } = current;
  const found = await (await ask("state", { name })).json();
  if (current.name === name) tell(found);
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
  const entry = { ...act, seconds: Math.min(Math.round(seconds * 10) / 10, 600) };
  seconds = 0;
  const sent = outbox.add(current.name, entry).catch(failed);
  stage.pending = outbox.waiting.filter((e) => e.name === current.name).map((e) => e.act);
  stage.draw();
  return sent;
}

function undo() {
  if (stage.polygon.length) {
    stage.polygon.pop();
    return stage.draw();
  }
  const last = state?.events.at(-1);
  if (last) send({ kind: "undo", of: last });
}

function redo() {
  const last = state?.redo.at(-1);
  if (last) send({ kind: "redo", of: last });
}

async function right() {
  if (stage.polygon.length) return hand.closePolygon();
  if (!current) return;
  const next = following();
  const last = pictures.every((one) => one.confirmed || one.name === current.name);
  await send({ kind: "right" });
  if (last) return notice(`All done: ${pictures.length} of ${pictures.length} right. To learn from them: ${learn}`);
  if (next && next !== current.name) open(next);
}

// --- sight ------------------------------------------------------------------------------

function fade(step) {
  stage.opacity = Math.min(1, Math.max(0.05, stage.opacity + step));
  by("opacity").value = stage.opacity;
  stage.draw();
}

function flip(name) {
  stage[name] = !stage[name];
  stage.draw();
}

// The colour of the road, by name; of infer's unless another was chosen in this browser.
function paint(name) {
  localStorage.roadtorchRoad = name;
  stage.road = ROADS[name] ?? ROADS.blue;
  document.documentElement.style.setProperty("--road", `rgb(${stage.road.join(" ")})`);
  if (current) stage.tint();
  stage.draw();
}

function recolour() {
  const names = Object.keys(ROADS);
  paint(names[(names.indexOf(localStorage.roadtorchRoad) + 1) % names.length]);
}

function sight() {
  stage.sight = stage.sight === "road" ? "layout" : "road";
  if (current) stage.tint();
  stage.draw();
}

// --- making the page --------------------------------------------------------------------

function named(what) {
  return what.replace("_", " ");
}

function choose(tool) {
  hand.choose(tool);
  marked("tools", tool);
}

function say(what) {
  hand.saying = what;
  marked("sayings", what);
}

function next(step) {
  const name = following(step);
  if (name) open(name);
}

function toList() {
  document.body.classList.toggle("listing");
  by("list").focus();
}

const KEYS = [
  ...SAYINGS.map((what, index) => [`${index + 1}`, `say ${named(what)}`, () => say(what)]),
  ...Object.entries(TOOLS).map(([tool, key]) => [key, `${tool} tool`, () => choose(tool)]),
  ["Enter", "right as it is, and on to the next; closes a polygon", right],
  ["n", "next picture, the least certain that waits", () => next(1)],
  ["k", "picture before it in the list", () => next(-1)],
  ["z", "undo (Ctrl+Z as well)", undo],
  ["y", "redo (Ctrl+Y as well)", redo],
  [" ", "click at the cross", () => hand.click()],
  ["Escape", "drop the polygon", () => hand.drop()],
  ["+", "zoom in", () => stage.zoomBy(1.25)],
  ["-", "zoom out", () => stage.zoomBy(0.8)],
  ["0", "whole picture", () => stage.fit()],
  ["[", "smaller brush", () => hand.resize(1 / 1.3)],
  ["]", "larger brush", () => hand.resize(1.3)],
  ["o", "fainter overlay", () => fade(-0.1)],
  ["O", "stronger overlay", () => fade(0.1)],
  ["h", "colour of the road", recolour],
  ["v", "overlay on and off", () => flip("hidden")],
  ["g", "borders of superpixels on and off", () => flip("borders")],
  ["l", "see road or layout", sight],
  ["m", "list of pictures (arrows move in it)", toList],
  ["?", "these keys", () => by("help").showModal()],
];

function build() {
  SAYINGS.forEach((what, i) => button("sayings", named(what), `${i + 1}`, () => say(what), what));
  for (const [tool, key] of Object.entries(TOOLS)) {
    button("tools", tool, key, () => choose(tool), tool);
  }
  button("acts", "right as it is", "⏎", right).classList.add("main");
  button("acts", "undo", "z", undo).dataset.act = "undo";
  button("acts", "redo", "y", redo).dataset.act = "redo";
  button("acts", "next", "n", () => next(1));
  button("sight", "−", "-", () => stage.zoomBy(0.8)).title = "zoom out";
  button("sight", "+", "+", () => stage.zoomBy(1.25)).title = "zoom in";
  button("sight", "whole", "0", () => stage.fit());
  button("sight", "road / layout", "l", sight);
  button("sight", "colour", "h", recolour);
  const range = Object.assign(document.createElement("input"), {
    type: "range", min: 0.05, max: 1, step: 0.05, value: stage.opacity, id: "opacity",
  });
  range.setAttribute("aria-label", "opacity (o, O)");
  range.addEventListener("input", () => fade(Number(range.value) - stage.opacity));
  by("sight").append(range);
  listKeys(KEYS);
}

function listen() {
  addEventListener("keydown", work);
  addEventListener("pointermove", work);
  onKeys(KEYS, (x, y, event) => {
    if (event.ctrlKey) stage.pan(-40 * x, -40 * y);
    else hand.nudge(x, y, event.shiftKey);
  });
  by("show-list").addEventListener("click", () => document.body.classList.toggle("listing"));
  by("help-button").addEventListener("click", () => by("help").showModal());
  by("hint").hidden = localStorage.roadtorchHint === "seen";
  by("hint-seen").addEventListener("click", () => {
    localStorage.roadtorchHint = "seen";
    by("hint").hidden = true;
  });
}

// The picture of the address, or the last one, or the least certain.
async function resume() {
  if (wanted || !pictures.length) return;
  const hash = decodeURIComponent(location.hash.slice(1));
  const last = [hash, localStorage.roadtorchLast];
  const known = last.find((one) => pictures.some((each) => each.name === one));
  const first = known ?? pictures.find((one) => !one.confirmed)?.name;
  await open(first ?? pictures[0].name);
}

async function poll() {
  await refresh();
  await resume();
  setTimeout(poll, POLL);
}

build();
listen();
paint(localStorage.roadtorchRoad in ROADS ? localStorage.roadtorchRoad : "blue");
say("road");
choose("superpixel");
poll();
