// The steps on connected regions, which the network's graph lacks: thin holes are filled, isolated
// road is removed, as by road/outlines.py and road/seed_area.py.

const MAX_HOLE_WIDTH = 11 / 640; // fraction of the image width

// Returns the pixels of an area (Uint8Array) that are 4-connected to one of its pixels in `start`.
function reconstruct(area, start, width) {
  const reached = new Uint8Array(area.length), stack = new Int32Array(area.length);
  let top = 0;
  const visit = (at) => { if (area[at] && !reached[at]) { reached[at] = 1; stack[top++] = at; } };
  for (let at = 0; at < area.length; at++) if (start[at]) visit(at);
  while (top) {
    const at = stack[--top], column = at % width;
    if (column) visit(at - 1);
    if (column < width - 1) visit(at + 1);
    if (at >= width) visit(at - width);
    if (at + width < area.length) visit(at + width);
  }
  return reached;
}

// Erodes an area along one axis by `side` pixels; pixels outside the image are background.
function erode(area, width, height, side, step, length) {
  const out = new Uint8Array(area.length), before = side >> 1;
  for (let line = 0; line < area.length / length; line++) {
    const start = step === 1 ? line * width : line;
    let holes = 0;
    for (let at = -side; at < length; at++) {
      const enter = at - before + side - 1, leave = at - before - 1;
      if (enter >= 0 && enter < length) holes += !area[start + enter * step];
      if (leave >= 0 && leave < length && at > -side) holes -= !area[start + leave * step];
      if (at >= 0) out[start + at * step] = !holes;
    }
  }
  return out;
}

// Fills the holes of a road mask in which no square of MAX_HOLE_WIDTH fits.
function fillThinHoles(mask, width, height) {
  const side = Math.max(2, Math.round(MAX_HOLE_WIDTH * width));
  const background = mask.map((road) => 1 - road);
  const wide = erode(erode(background, width, height, side, 1, width), width, height, side, width, height);
  if (!wide.includes(1)) return mask;
  return reconstruct(background, wide, width).map((outside) => 1 - outside);
}

// Computes the mask (1 is road) from the graph's maps of width × height pixels and a threshold.
export function computeMask({ likelihood, ego, seed_area: seed, width, height }, threshold) {
  let mask = Uint8Array.from(likelihood, (value) => value >= threshold);
  mask = fillThinHoles(mask, width, height);
  for (let at = width; at < mask.length; at++) if (ego[at]) mask[at] = mask[at - width]; // extrapolate over the ego car
  const connected = reconstruct(mask, seed, width);
  const road = connected.includes(1) ? connected : mask;
  return road.map((value, at) => value && !ego[at] ? 1 : 0);
}
