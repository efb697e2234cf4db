// The map: cells, path, goal, scan and robot on a canvas that can be moved and zoomed.

const COLORS = { unknown: "#b9c3cc", robot: "#009e73", path: "#0072b2", scan: "#d55e00", goal: "#a3407a", closed: "#b00020", allowed: "#009e73", ink: "#17202a" };
const ROBOT_M = 0.18;

export class MapView {
  constructor(canvas, pick) {
    this.canvas = canvas;
    this.pick = pick;
    this.scale = 60; // Pixels a metre.
    this.center = { x: 0, y: 0 };
    this.follows = true;
    this.pose = null;
    this.laser = { x: 0, y: 0 };
    this.path = [];
    this.goal = null;
    this.asked = null;
    this.closed = [];
    this.allowed = [];
    this.draft = [];
    this.pointers = new Map();
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  // The cells as an image of one pixel each. Only the occupancy, the last byte, is read.
  setGrid(grid) {
    const cells = new OffscreenCanvas(Math.max(1, grid.columns), Math.max(1, grid.rows));
    const context = cells.getContext("2d");
    const image = context.createImageData(cells.width, cells.height);
    const pixels = new Uint32Array(image.data.buffer);
    for (let row = 0; row < grid.rows; row++) {
      for (let column = 0; column < grid.columns; column++) {
        const value = grid.data[row * grid.rowStride + column * grid.stride + grid.stride - 1];
        const color = value > 127 ? 0 : value >= 50 ? 0xff2a2017 : 0xffffffff;
        pixels[(grid.rows - 1 - row) * grid.columns + column] = color;
      }
    }
    context.putImageData(image, 0, 0);
    if (!this.grid) this.fit(grid);
    this.grid = { ...grid, cells };
    this.draw();
  }

  fit(grid) {
    const width = Math.max(6, grid.columns * grid.cell);
    const height = Math.max(6, grid.rows * grid.cell);
    this.scale = 0.85 * Math.min(this.canvas.clientWidth / width, this.canvas.clientHeight / height);
  }

  set(parts) {
    Object.assign(this, parts);
    if (this.follows && this.pose) this.center = { x: this.pose.x, y: this.pose.y };
    this.draw();
  }

  // From metres in the map to pixels of the canvas, and back. The map's x points right, its y up.
  toPixels({ x, y }) {
    return [this.width / 2 + (x - this.center.x) * this.scale, this.height / 2 - (y - this.center.y) * this.scale];
  }

  toMetres(px, py) {
    return { x: this.center.x + (px - this.width / 2) / this.scale, y: this.center.y - (py - this.height / 2) / this.scale };
  }

  draw() {
    if (this.due) return;
    this.due = requestAnimationFrame(() => {
      this.due = null;
      this.paint();
    });
  }

  paint() {
    const ratio = devicePixelRatio || 1;
    this.width = this.canvas.clientWidth;
    this.height = this.canvas.clientHeight;
    this.canvas.width = this.width * ratio;
    this.canvas.height = this.height * ratio;
    const context = this.canvas.getContext("2d");
    context.scale(ratio, ratio);
    context.fillStyle = COLORS.unknown;
    context.fillRect(0, 0, this.width, this.height);
    this.paintCells(context);
    for (const corners of this.allowed) this.paintOutline(context, corners);
    for (const corners of this.closed) this.paintArea(context, corners, true);
    this.paintArea(context, this.draft, false);
    this.paintScale(context);
    this.paintPath(context);
    this.paintScan(context);
    if (this.goal) this.paintGoal(context, this.goal, COLORS.goal);
    if (this.asked) this.paintGoal(context, this.asked, COLORS.path);
    this.paintRobot(context);
  }

  paintCells(context) {
    if (!this.grid) return;
    const { x, y, columns, rows, cell, cells } = this.grid;
    const [left, top] = this.toPixels({ x, y: y + rows * cell });
    context.imageSmoothingEnabled = false;
    context.drawImage(cells, left, top, columns * cell * this.scale, rows * cell * this.scale);
  }

  // An area that the robot does not leave: its outline only.
  paintOutline(context, corners) {
    context.save();
    context.strokeStyle = COLORS.allowed;
    context.lineWidth = 3;
    context.setLineDash([8, 5]);
    context.beginPath();
    for (const corner of corners) context.lineTo(...this.toPixels(corner));
    context.closePath();
    context.stroke();
    context.restore();
  }

  // Dashed and filled; one that is being drawn has dots at its corners.
  paintArea(context, corners, isClosed) {
    if (corners.length === 0) return;
    context.save();
    context.strokeStyle = context.fillStyle = COLORS.closed;
    context.lineWidth = 3;
    context.setLineDash([8, 5]);
    context.beginPath();
    for (const corner of corners) context.lineTo(...this.toPixels(corner));
    if (isClosed) context.closePath();
    context.stroke();
    context.globalAlpha = 0.2;
    context.fill();
    context.globalAlpha = 1;
    for (const corner of isClosed ? [] : corners) {
      const [px, py] = this.toPixels(corner);
      context.fillRect(px - 5, py - 5, 10, 10);
    }
    context.restore();
  }

  // In the upper left corner, on a narrow screen below the buttons.
  paintScale(context) {
    const metres = [0.5, 1, 2, 5, 10, 20].find((metres) => metres * this.scale > 60) ?? 50;
    const left = 16;
    const right = left + metres * this.scale;
    const tools = this.canvas.parentElement.querySelector(".map-tools");
    const y = 34 + (tools.offsetLeft < right + 8 ? tools.offsetHeight : 0);
    context.fillStyle = "#fffffff0";
    context.fillRect(left - 8, y - 24, right - left + 16, 32);
    context.strokeStyle = context.fillStyle = COLORS.ink;
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(left, y - 5);
    context.lineTo(left, y);
    context.lineTo(right, y);
    context.lineTo(right, y - 5);
    context.stroke();
    context.font = "13px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(`${metres} m`, (left + right) / 2, y - 6);
  }

  paintPath(context) {
    if (this.path.length < 2) return;
    context.strokeStyle = COLORS.path;
    context.lineWidth = 4;
    context.lineJoin = "round";
    context.beginPath();
    for (const pose of this.path) context.lineTo(...this.toPixels(pose));
    context.stroke();
  }

  paintScan(context) {
    if (!this.scan || !this.pose) return;
    const { start, end, ranges } = this.scan;
    const step = (end - start) / Math.max(1, ranges.length - 1);
    const [cos, sin] = [Math.cos(this.pose.yaw), Math.sin(this.pose.yaw)];
    const origin = { x: this.pose.x + cos * this.laser.x - sin * this.laser.y, y: this.pose.y + sin * this.laser.x + cos * this.laser.y };
    context.fillStyle = COLORS.scan;
    ranges.forEach((range, beam) => {
      if (!Number.isFinite(range)) return;
      const angle = this.pose.yaw + start + beam * step;
      const [px, py] = this.toPixels({ x: origin.x + range * Math.cos(angle), y: origin.y + range * Math.sin(angle) });
      context.fillRect(px - 1.5, py - 1.5, 3, 3);
    });
  }

  paintGoal(context, place, color) {
    const [px, py] = this.toPixels(place);
    context.fillStyle = color;
    context.strokeStyle = "#fff";
    context.lineWidth = 2;
    context.beginPath();
    [[0, -10], [8, 0], [0, 10], [-8, 0]].forEach(([dx, dy]) => context.lineTo(px + dx, py + dy));
    context.closePath();
    context.fill();
    context.stroke();
  }

  paintRobot(context) {
    if (!this.pose) return;
    const [px, py] = this.toPixels(this.pose);
    const radius = Math.max(9, ROBOT_M * this.scale);
    context.save();
    context.translate(px, py);
    context.rotate(-this.pose.yaw);
    context.fillStyle = COLORS.robot;
    context.strokeStyle = "#fff";
    context.lineWidth = 2;
    context.beginPath();
    context.arc(0, 0, radius, 0, 2 * Math.PI);
    context.fill();
    context.stroke();
    context.fillStyle = "#fff";
    context.beginPath();
    [[0.8, 0], [-0.5, 0.5], [-0.2, 0], [-0.5, -0.5]].forEach(([x, y]) => context.lineTo(radius * x, radius * y));
    context.fill();
    context.restore();
  }

  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const before = this.toMetres(px, py);
    this.scale = Math.min(400, Math.max(5, this.scale * factor));
    const after = this.toMetres(px, py);
    if (!this.follows) this.move(before.x - after.x, before.y - after.y);
    this.draw();
  }

  move(dx, dy) {
    this.center = { x: this.center.x + dx, y: this.center.y + dy };
    this.draw();
  }

  setFollows(follows) {
    this.follows = follows;
    this.canvas.dispatchEvent(new Event("follows"));
    this.set({});
  }

  listen() {
    const { canvas, pointers } = this;
    const place = (event) => {
      const box = canvas.getBoundingClientRect();
      return { px: event.clientX - box.left, py: event.clientY - box.top };
    };
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, place(event));
      this.moved = pointers.size > 1 ? Infinity : 0;
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const now = place(event);
      this.drag(event.pointerId, before, now);
      pointers.set(event.pointerId, now);
    });
    const end = (event) => {
      const was = pointers.get(event.pointerId);
      pointers.delete(event.pointerId);
      if (event.type === "pointerup" && was && this.moved < 8) this.pick(this.toMetres(was.px, was.py));
    };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const { px, py } = place(event);
      this.zoom(Math.exp(-event.deltaY / 400), px, py);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  // One pointer moves the map, two zoom it.
  drag(id, before, now) {
    if (this.pointers.size === 1) {
      this.moved += Math.hypot(now.px - before.px, now.py - before.py);
      if (this.moved < 8) return;
      if (this.follows) this.setFollows(false);
      this.move((before.px - now.px) / this.scale, (now.py - before.py) / this.scale);
      return;
    }
    const [other] = [...this.pointers].filter(([key]) => key !== id).map(([, at]) => at);
    const span = (at) => Math.hypot(at.px - other.px, at.py - other.py);
    this.zoom(span(now) / Math.max(1, span(before)), (now.px + other.px) / 2, (now.py + other.py) / 2);
  }

  key(event) {
    const step = 60 / this.scale;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (moves[event.key]) {
      event.preventDefault();
      if (this.follows) this.setFollows(false);
      this.move(...moves[event.key]);
    } else if (event.key === "+" || event.key === "=") this.zoom(1.25);
    else if (event.key === "-") this.zoom(0.8);
  }
}
