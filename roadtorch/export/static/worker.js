// Runs the network in a worker, so that the page stays responsive.
import * as ort from "./ort.wasm.min.mjs";
import { computeMask } from "./mask.js";

let session;

async function load() {
  ort.env.wasm.wasmPaths = new URL("./", import.meta.url).href;
  ort.env.wasm.numThreads = self.crossOriginIsolated ? Math.min(8, navigator.hardwareConcurrency || 1) : 1;
  session = await ort.InferenceSession.create("road.onnx", { executionProviders: ["wasm"] });
  return { threads: ort.env.wasm.numThreads };
}

let latest; // maps of the last image

// Runs the network on an image's bytes. Returns likelihood, mask, trust, and milliseconds.
async function detect({ rgba, width, height, threshold }) {
  const start = performance.now(), rgb = new Uint8Array(width * height * 3);
  for (let at = 0, to = 0; to < rgb.length; at += 4) for (let c = 0; c < 3; c++) rgb[to++] = rgba[at + c];
  const outputs = await session.run({ image: new ort.Tensor("uint8", rgb, [1, height, width, 3]) });
  latest = { width, height };
  for (const name of ["likelihood", "ego", "seed_area"]) latest[name] = outputs[name].data;
  const mask = computeMask(latest, threshold);
  return { likelihood: latest.likelihood, mask, trust: outputs.trust.data[0], ms: performance.now() - start, width, height };
}

const calls = { load, detect, mask: ({ threshold }) => computeMask(latest, threshold) };

self.onmessage = async ({ data: { id, call, values } }) => {
  try {
    self.postMessage({ id, result: await calls[call](values) });
  } catch (error) {
    self.postMessage({ id, message: String(error?.message ?? error) });
  }
};
