// Drawing tools, used by pointers and keys.

export class Tools {
  // stage: canvas. send(event): sends the event of a finished stroke. ready(): whether an image is open.
  constructor(stage, send, ready) {
    Object.assign(this, { stage, send, ready, label: "road", drawing: false, panning: false });
    this.pointers = new Map();
    this.spread = 0;
    const { canvas } = stage;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.up(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => stage.tool === "polygon" && this.closePolygon());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      stage.zoomBy(event.deltaY < 0 ? 1.15 : 1 / 1.15, ...stage.at(event));
    }, { passive: false });
  }

  choose(tool) {
    this.stage.tool = tool;
    this.discard();
  }

  discard() {
    this.stage.polygon = [];
    this.stage.draw();
  }

  // --- tools ----------------------------------------------------------------------------

  begin(point) {
    const { stage } = this;
    if (stage.tool === "superpixel") stage.drag.add(stage.superpixel(point));
    if (stage.tool === "brush") stage.strokes = [{ points: [point], radius: stage.radius }];
    if (stage.tool === "polygon") {
      const first = stage.polygon[0];
      const near = first && Math.hypot(first[0] - point[0], first[1] - point[1]) * stage.zoom < 10;
      if (near && stage.polygon.length >= 3) return this.closePolygon();
      stage.polygon.push(point);
    }
    stage.draw();
  }

  extend(point) {
    const { stage } = this;
    if (stage.tool === "superpixel") stage.drag.add(stage.superpixel(point));
    if (stage.tool === "brush") stage.strokes[0]?.points.push(point);
  }

  end() {
    const { stage, label } = this;
    if (stage.tool === "superpixel") {
      const segments = [...stage.drag].filter((segment) => segment >= 0);
      stage.drag.clear();
      if (segments.length) this.send({ kind: "superpixel", label, segments });
    }
    if (stage.tool === "brush") {
      const points = rounded(stage.strokes[0]?.points ?? []);
      stage.strokes = [];
      if (points.length) this.send({ kind: "brush", label, points, radius: stage.radius });
    }
  }

  closePolygon() {
    const points = rounded(this.stage.polygon);
    this.discard();
    if (points.length >= 3) this.send({ kind: "polygon", label: this.label, points });
  }

  // --- pointers -------------------------------------------------------------------------

  moveCursor(point) {
    this.stage.cursor = point;
    this.stage.hover = this.stage.superpixel(point);
  }

  down(event) {
    const { stage, pointers } = this;
    if (!this.ready()) return;
    stage.canvas.focus({ preventScroll: true });
    stage.canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, stage.at(event));
    this.panning = event.button === 1 || event.button === 2 || pointers.size > 1;
    if (pointers.size > 1) {
      Object.assign(stage, { strokes: [], drag: new Set() });
      this.drawing = false;
      this.spread = this.distance();
    } else if (!this.panning) {
      this.drawing = true;
      this.moveCursor(stage.onImage(stage.at(event)));
      this.begin(stage.cursor);
    }
    event.preventDefault();
  }

  distance() {
    const [[x, y], [u, v]] = [...this.pointers.values()];
    return Math.hypot(x - u, y - v);
  }

  move(event) {
    const { stage, pointers } = this;
    if (!this.ready()) return;
    const point = stage.at(event);
    const last = pointers.get(event.pointerId);
    if (last && this.panning) return this.drag(event, point, last);
    this.moveCursor(stage.onImage(point));
    if (this.drawing) this.extend(stage.cursor);
    stage.draw();
  }

  // Pan with one pointer, zoom with two.
  drag(event, point, last) {
    const { stage, pointers } = this;
    stage.pan((point[0] - last[0]) / pointers.size, (point[1] - last[1]) / pointers.size);
    pointers.set(event.pointerId, point);
    if (pointers.size !== 2) return;
    const spread = this.distance();
    stage.zoomBy(spread / this.spread, point[0], point[1]);
    this.spread = spread;
  }

  up(event) {
    this.pointers.delete(event.pointerId);
    if (this.drawing && event.type === "pointerup") this.end();
    this.drawing = false;
    if (!this.pointers.size) this.panning = false;
    this.stage.draw();
  }

  // --- keys -----------------------------------------------------------------------------

  nudge(x, y, fine) {
    if (!this.ready()) return;
    const { stage } = this;
    const [width, height] = stage.image.size;
    const step = fine ? 1 : width / 80;
    const inside = (value, most) => Math.min(Math.max(value, 0), most - 1);
    this.moveCursor([inside(stage.cursor[0] + x * step, width), inside(stage.cursor[1] + y * step, height)]);
    stage.draw();
  }

  click() {
    if (!this.ready()) return;
    this.begin(this.stage.cursor);
    this.end();
  }

  resize(factor) {
    const { stage } = this;
    stage.radius = Math.min(400, Math.max(1, Math.round(stage.radius * factor + (factor > 1))));
    stage.draw();
  }
}

function rounded(points) {
  return points.map((point) => point.map((value) => Math.round(value * 10) / 10));
}
