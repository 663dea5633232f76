// Sends images, videos and the camera to the worker, and draws its results on the canvas.

const MAX_MEGAPIXELS = 100; // of a file
const STILL = 2e6, MOVING = 160e3; // pixels that the network gets, of an image and of a frame
const TINT = [86, 180, 233, 0.5], EDGE = [230, 159, 0, 1]; // as in roadtorch's overlays

const $ = (id) => document.getElementById(id);
const canvas = $("image"), context = canvas.getContext("2d", { willReadFrequently: true });
let current = null; // on the canvas: the image's bytes, likelihood, mask, trust
let playing = null; // the video element that is running

function setStatus(text, isError = false) {
  $("status").textContent = text;
  $("status").classList.toggle("error", isError);
}

// --- the worker -------------------------------------------------------------------------

const waiting = new Map();
let worker, calls = 0;

function request(call, values) {
  const id = calls++;
  worker.postMessage({ id, call, values });
  return new Promise((resolve, reject) => waiting.set(id, { resolve, reject }));
}

async function start() {
  if (!WebAssembly?.validate(Uint8Array.of(0, 97, 115, 109, 1, 0, 0, 0, 1, 5, 1, 96, 0, 1, 123, 3, 2, 1, 0, 10, 10, 1, 8, 0, 65, 0, 253, 15, 253, 98, 11)))
    return setStatus("This browser has no WebAssembly SIMD, which the network needs. Use a newer one.", true);
  setStatus("Loading the network (24 MB the first time)…");
  navigator.serviceWorker?.register("offline.js").catch(() => {}); // without it the page does not open offline
  worker = new Worker("worker.js", { type: "module" });
  worker.onmessage = ({ data: { id, result, message } }) => {
    const { resolve, reject } = waiting.get(id);
    waiting.delete(id);
    if (message) reject(new Error(message)); else resolve(result);
  };
  worker.onerror = () => setStatus("The network's worker does not start: reload the page, or use a newer browser.", true);
  try {
    const { threads } = await request("load");
    setStatus(`Ready: ${threads === 1 ? "one thread" : `${threads} threads`}.`);
  } catch (error) {
    return setStatus(`The network cannot be loaded: ${error.message}`, true);
  }
  for (const id of ["file", "camera", "example"]) $(id).disabled = false;
}

// --- images ---------------------------------------------------------------------------

// Detects road in an image or frame, reduced to at most so many pixels.
async function detect(drawable, width, height, maxPixels) {
  const scale = Math.min(1, Math.sqrt(maxPixels / (width * height)));
  const [w, h] = [width, height].map((side) => Math.max(16, Math.round(side * scale)));
  const small = new OffscreenCanvas(w, h).getContext("2d");
  small.imageSmoothingQuality = "high";
  small.fillRect(0, 0, w, h); // transparent pixels become black
  small.drawImage(drawable, 0, 0, w, h);
  const rgba = small.getImageData(0, 0, w, h).data;
  current = { rgba, ...await request("detect", { rgba, width: w, height: h, threshold: +$("threshold").value }) };
  draw();
}

async function openImage(file, name) {
  const address = URL.createObjectURL(file), image = new Image();
  try {
    image.src = address;
    await new Promise((resolve, reject) => { image.onload = resolve; image.onerror = reject; });
    const pixels = image.naturalWidth * image.naturalHeight;
    if (pixels > MAX_MEGAPIXELS * 1e6)
      return setStatus(`${name} has ${Math.round(pixels / 1e6)} megapixels: more than ${MAX_MEGAPIXELS}. Reduce its size.`, true);
    setStatus(`Detecting road in ${name}…`);
    await image.decode();
    const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none" });
    await detect(bitmap, bitmap.width, bitmap.height, STILL);
    bitmap.close();
    setStatus(name);
  } catch (error) {
    const isWorkerError = error instanceof Error && !(error instanceof DOMException);
    setStatus(isWorkerError ? `${name}: ${error.message}` : `${name} is not an image or video that this browser reads.`, true);
  } finally {
    URL.revokeObjectURL(address);
  }
}

async function open(file) {
  stop();
  if (!file.type.startsWith("video/")) return openImage(file, file.name);
  const video = document.createElement("video");
  video.src = URL.createObjectURL(file);
  video.loop = true;
  await play(video, file.name);
}

// --- videos and the camera --------------------------------------------------------------

async function play(video, name) {
  playing = video;
  video.muted = video.playsInline = true;
  try {
    await video.play();
  } catch {
    if (playing === video) stop();
    return setStatus(`${name} is not an image or video that this browser reads.`, true);
  }
  $("stop").hidden = false;
  setStatus(name);
  let last = performance.now();
  while (playing === video) {
    if (video.videoWidth) await detect(video, video.videoWidth, video.videoHeight, MOVING).catch((error) => { stop(); setStatus(error.message, true); });
    await new Promise(requestAnimationFrame);
    const now = performance.now();
    if (playing === video) $("time").textContent += ` (${(1000 / (now - last)).toFixed(1)} a second)`;
    last = now;
  }
}

function stop() {
  if (!playing) return;
  playing.pause();
  playing.srcObject?.getTracks().forEach((track) => track.stop());
  if (!playing.srcObject) URL.revokeObjectURL(playing.src);
  playing = null;
  $("stop").hidden = true;
}

async function openCamera() {
  stop();
  const video = document.createElement("video");
  try {
    if (!navigator.mediaDevices) throw new Error("cameras need https, or localhost");
    video.srcObject = await navigator.mediaDevices.getUserMedia({ video: { facingMode: "environment" } });
  } catch (error) {
    return setStatus(`No camera: ${error.message}`, true);
  }
  await play(video, "Camera");
}

// --- drawing -------------------------------------------------------------------------------

function colour({ rgba, likelihood, mask, width }, view) {
  const pixels = new Uint8ClampedArray(rgba);
  if (view === "likelihood")
    likelihood.forEach((value, at) => pixels.fill(Math.round(value * 255), 4 * at, 4 * at + 3));
  if (view !== "overlay") return pixels;
  mask.forEach((road, at) => {
    if (!road) return;
    const column = at % width;
    const inside = mask[at - width] !== 0 && mask[at + width] !== 0
      && (!column || mask[at - 1]) && (column === width - 1 || mask[at + 1]);
    const [r, g, b, a] = inside ? TINT : EDGE;
    for (const [c, value] of [r, g, b].entries()) pixels[4 * at + c] += (value - pixels[4 * at + c]) * a;
  });
  return pixels;
}

function draw() {
  const { width, height, mask, trust, ms } = current;
  const view = document.querySelector("[name=view]:checked").value;
  Object.assign(canvas, { width, height });
  context.putImageData(new ImageData(colour(current, view), width, height), 0, 0);
  const fraction = mask.reduce((sum, road) => sum + road, 0) / mask.length;
  $("fraction").textContent = `${(100 * fraction).toFixed(1)} %`;
  $("trust").textContent = `${trust.toFixed(2)}${trust < 0.6 ? ", doubtful" : ""}`;
  $("time").textContent = `${Math.round(ms)} ms`;
  canvas.setAttribute("aria-label", `${fraction ? `Road on ${Math.round(100 * fraction)} % of the image` : "No road found"}, trust ${trust.toFixed(2)}`);
}

async function changeThreshold() {
  const threshold = +$("threshold").value;
  $("level").textContent = threshold.toFixed(2);
  if (!current || playing) return;
  const { likelihood } = current, mask = await request("mask", { threshold });
  if (current.likelihood === likelihood && threshold === +$("threshold").value) { current.mask = mask; draw(); }
}

// --- controls ---------------------------------------------------------------------------

$("file").onchange = ({ target }) => { if (target.files[0]) open(target.files[0]); target.value = ""; };
$("camera").onclick = openCamera;
$("stop").onclick = () => { stop(); setStatus("Stopped."); };
$("example").onclick = async () => { stop(); openImage(await (await fetch("street.jpg")).blob(), "A rendered street"); };
$("threshold").oninput = changeThreshold;
$("views").onchange = () => { if (current) draw(); };
addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
addEventListener("dragleave", () => document.body.classList.remove("over"));
addEventListener("drop", (event) => {
  event.preventDefault();
  document.body.classList.remove("over");
  if (event.dataTransfer.files[0] && !$("file").disabled) open(event.dataTransfer.files[0]);
});
window.roadtorch = { state: () => current }; // for tests

start();
