// The canvas: position and zoom of the image, overlays, and coordinates of the pointer.

const SKY = [204, 121, 167]; // blue is road
const LABELS = {
  2: [213, 94, 0], 3: [139, 139, 139], 4: SKY, 5: [230, 159, 0], 6: [0, 120, 106], 7: [213, 94, 0],
};
const LAYOUT = [SKY, [230, 159, 0], [0, 120, 106]];
const ROAD = [86, 180, 233]; // as infer draws it

const TINT = 120, TINT_OF_DARK = 220; // opacity of the detected road, of 255
const DARK = 60; // mean grey level below which a weak tint is invisible

function isDark(bitmap) {
  const pen = new OffscreenCanvas(16, 16).getContext("2d");
  pen.drawImage(bitmap, 0, 0, 16, 16);
  const { data } = pen.getImageData(0, 0, 16, 16);
  return data.reduce((sum, value, i) => sum + (i % 4 < 3 ? value : 0), 0) / (3 * 256) < DARK;
}

export class Stage {
  constructor(canvas) {
    Object.assign(this, {
      canvas, pen: canvas.getContext("2d"), image: null, zoom: 1, left: 0, top: 0, opacity: 0.5,
      layer: "road", borders: false, hidden: false, cursor: null, hover: -1, drag: new Set(),
      strokes: [], pending: [], polygon: [], radius: 12, tool: "superpixel",
    });
    this.overlay = document.createElement("canvas");
    this.highlight = document.createElement("canvas");
    new ResizeObserver(() => this.resize()).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // image: {bitmap, size [W,H], shape [w,h], superpixels Uint16Array}; layers: Uint8Array.
  show(image, layers) {
    const isNew = this.image !== image;
    Object.assign(this, { image, layers });
    for (const canvas of [this.overlay, this.highlight]) {
      if (canvas.width !== image.shape[0] || canvas.height !== image.shape[1]) {
        [canvas.width, canvas.height] = image.shape;
      }
    }
    if (isNew) {
      Object.assign(this, { hover: -1, drag: new Set(), strokes: [], polygon: [], pending: [] });
      this.tinted = isDark(image.bitmap) ? TINT_OF_DARK : TINT;
      this.cursor = [image.size[0] / 2, image.size[1] * 0.75];
      this.fit();
    }
    this.tint();
    this.draw();
  }

  resize() {
    const ratio = devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const fitted = this.fitted;
    this.canvas.width = Math.max(1, Math.round(width * ratio));
    this.canvas.height = Math.max(1, Math.round(height * ratio));
    if (this.image && fitted !== false) this.fit();
    this.draw();
  }

  fit() {
    const [width, height] = this.image.size;
    const { width: across, height: down } = this.canvas;
    this.zoom = Math.min(across / width, down / height);
    this.left = (across - width * this.zoom) / 2;
    this.top = (down - height * this.zoom) / 2;
    this.fitted = true;
    this.draw();
  }

  // Zoom by a factor about a point of the canvas, by default its centre.
  zoomBy(factor, x = this.canvas.width / 2, y = this.canvas.height / 2) {
    if (!this.image) return;
    const zoom = Math.min(Math.max(this.zoom * factor, 0.05), 40);
    this.left = x - ((x - this.left) * zoom) / this.zoom;
    this.top = y - ((y - this.top) * zoom) / this.zoom;
    this.zoom = zoom;
    this.fitted = false;
    this.draw();
  }

  pan(x, y) {
    this.left += x;
    this.top += y;
    this.fitted = false;
    this.draw();
  }

  // Return the canvas pixel of a pointer event.
  at(event) {
    const box = this.canvas.getBoundingClientRect();
    const ratio = this.canvas.width / box.width;
    return [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  }

  // Return image coordinates of a canvas pixel, integers at pixel centres.
  onImage([x, y]) {
    return [(x - this.left) / this.zoom - 0.5, (y - this.top) / this.zoom - 0.5];
  }

  // Return the superpixel at image coordinates; -1 outside.
  superpixel([x, y]) {
    const [width, height] = this.image.size;
    const [across, down] = this.image.shape;
    const column = Math.floor(((x + 0.5) / width) * across);
    const row = Math.floor(((y + 0.5) / height) * down);
    if (column < 0 || row < 0 || column >= across || row >= down) return -1;
    return this.image.superpixels[row * across + column];
  }

  // Colour the layers; the bits of a byte are three of the label, one of road, two of layout.
  tint() {
    const [width, height] = this.image.shape;
    const image = new ImageData(width, height);
    const { layers } = this;
    for (let i = 0; i < layers.length; i++) {
      const label = layers[i] & 7;
      const road = (layers[i] >> 3) & 1;
      let colour = null;
      let strength = 0;
      if (this.layer === "road") {
        const right = i % width < width - 1 ? (layers[i + 1] >> 3) & 1 : road;
        const below = i + width < layers.length ? (layers[i + width] >> 3) & 1 : road;
        if (label) [colour, strength] = [LABELS[label] ?? ROAD, label === 6 ? 90 : 200];
        else if (road) [colour, strength] = [ROAD, this.tinted];
        if (road !== right || road !== below) [colour, strength] = [[255, 255, 255], 255];
      } else {
        const layout = layers[i] >> 4;
        const labelled = { 1: 2, 4: 0, 5: 1, 6: 2, 7: 2 }[label];
        if (labelled !== undefined) [colour, strength] = [LAYOUT[labelled], 210];
        else if (layout < 3) [colour, strength] = [LAYOUT[layout], 110];
      }
      if (colour) image.data.set([...colour, strength], 4 * i);
    }
    this.overlay.getContext("2d").putImageData(image, 0, 0);
  }

  // Highlight superpixels dragged over and under the pointer, and all borders on demand.
  highlightSuperpixels() {
    const { superpixels, shape } = this.image;
    const [width, height] = shape;
    const image = new ImageData(width, height);
    const hover = this.tool === "superpixel" ? this.hover : -1;
    if (hover < 0 && !this.drag.size && !this.borders) return null;
    for (let i = 0; i < superpixels.length; i++) {
      const label = superpixels[i];
      if (this.drag.has(label)) image.data.set([255, 255, 0, 150], 4 * i);
      else if (label === hover) image.data.set([255, 255, 255, 90], 4 * i);
      else if (this.borders && (superpixels[i + 1] !== label || superpixels[i + width] !== label)) {
        image.data.set([255, 255, 255, 110], 4 * i);
      }
    }
    this.highlight.getContext("2d").putImageData(image, 0, 0);
    return this.highlight;
  }

  draw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.paint());
  }

  paint() {
    const { pen, canvas, image } = this;
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, canvas.width, canvas.height);
    if (!image) return;
    const [width, height] = image.size;
    pen.setTransform(this.zoom, 0, 0, this.zoom, this.left, this.top);
    pen.imageSmoothingEnabled = this.zoom < 3;
    pen.drawImage(image.bitmap, 0, 0, width, height);
    pen.imageSmoothingEnabled = false;
    if (!this.hidden) {
      pen.globalAlpha = this.opacity;
      pen.drawImage(this.overlay, 0, 0, width, height);
      pen.globalAlpha = 1;
    }
    const highlight = this.highlightSuperpixels();
    if (highlight) pen.drawImage(highlight, 0, 0, width, height);
    for (const stroke of [...this.pending, ...this.strokes]) this.outline(stroke);
    if (this.polygon.length) this.outline({ points: this.polygon, open: true });
    this.drawCursor();
  }

  // Draw a stroke that is unfinished, or not yet acknowledged by the server.
  outline({ points, radius, open }) {
    if (!points?.length) return;
    const { pen } = this;
    pen.beginPath();
    for (const [x, y] of points) pen.lineTo(x + 0.5, y + 0.5);
    if (!radius && !open) pen.closePath();
    pen.lineCap = pen.lineJoin = "round";
    pen.lineWidth = radius ? 2 * radius + 1 : 2 / this.zoom;
    pen.strokeStyle = radius ? "rgb(255 255 0 / .5)" : "rgb(255 255 0)";
    if (radius && points.length === 1) pen.lineTo(points[0][0] + 0.51, points[0][1] + 0.5);
    pen.stroke();
    if (radius) return;
    pen.fillStyle = "rgb(255 255 0)";
    for (const [x, y] of points) {
      pen.fillRect(x + 0.5 - 3 / this.zoom, y + 0.5 - 3 / this.zoom, 6 / this.zoom, 6 / this.zoom);
    }
  }

  // Draw the keyboard cursor, or the ring of the brush.
  drawCursor() {
    if (!this.cursor) return;
    const { pen } = this;
    const [x, y] = this.cursor.map((value) => value + 0.5);
    const arm = 12 / this.zoom;
    for (const [colour, width] of [["rgb(0 0 0 / .7)", 4], ["rgb(255 255 255)", 1.5]]) {
      pen.strokeStyle = colour;
      pen.lineWidth = width / this.zoom;
      pen.beginPath();
      if (this.tool === "brush") pen.arc(x, y, this.radius + 0.5, 0, 2 * Math.PI);
      pen.moveTo(x - arm, y);
      pen.lineTo(x + arm, y);
      pen.moveTo(x, y - arm);
      pen.lineTo(x, y + arm);
      pen.stroke();
    }
  }
}
