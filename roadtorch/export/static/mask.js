// What the network's graph leaves to whoever runs it: connected regions. The same steps as
// road/outlines.py (filled) and road/seed_area.py (remove_isolated).

const THIN = 11 / 640; // of the width: holes up to which are filled

// Which pixels of an area (Uint8Array) are 4-connected to a pixel of it where `start` is not 0.
function reached(area, start, width) {
  const kept = new Uint8Array(area.length), stack = new Int32Array(area.length);
  let top = 0;
  const visit = (at) => { if (area[at] && !kept[at]) { kept[at] = 1; stack[top++] = at; } };
  for (let at = 0; at < area.length; at++) if (start[at]) visit(at);
  while (top) {
    const at = stack[--top], column = at % width;
    if (column) visit(at - 1);
    if (column < width - 1) visit(at + 1);
    if (at >= width) visit(at - width);
    if (at + width < area.length) visit(at + width);
  }
  return kept;
}

// The minimum over `side` pixels along one axis; what is outside the image is background.
function eroded(area, width, height, side, step, length) {
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

// Fills the holes of a road mask into which no square of a line's width fits.
function filled(mask, width, height) {
  const side = Math.max(2, Math.round(THIN * width));
  const background = mask.map((road) => 1 - road);
  const wide = eroded(eroded(background, width, height, side, 1, width), width, height, side, width, height);
  if (!wide.includes(1)) return mask;
  return reached(background, wide, width).map((outside) => 1 - outside);
}

// The mask (1 is road) of the graph's maps of width × height pixels at a threshold.
export function maskOf({ likelihood, ego, seed_area: seed, width, height }, threshold) {
  let mask = Uint8Array.from(likelihood, (value) => value >= threshold);
  mask = filled(mask, width, height);
  for (let at = width; at < mask.length; at++) if (ego[at]) mask[at] = mask[at - width]; // the ground goes on
  const kept = reached(mask, seed, width);
  const shown = kept.includes(1) ? kept : mask;
  return shown.map((road, at) => road && !ego[at] ? 1 : 0);
}
