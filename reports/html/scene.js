// Bird's-eye and 3D view of one frame.
const EDGES = [];
for (let i = 0; i < 8; i++) for (const bit of [1, 2, 4]) if (!(i & bit)) EDGES.push([i, i | bit]);
const BOTTOM = [4, 5, 7, 6]; // corner i: bit 0 is rear, bit 1 right, bit 2 bottom
const NO_SPEED = -32768;
const clouds = new Map();

function cloud(number) {
  if (!clouds.has(number)) {
    const bytes = Uint8Array.from(atob(data.clouds[number]), (c) => c.charCodeAt(0));
    clouds.set(number, new Int16Array(bytes.buffer));
  }
  return clouds.get(number);
}

const corner = (box, i) => [box.corners[3 * i], box.corners[3 * i + 1], box.corners[3 * i + 2]];
const middle = (box) => [0, 1, 2].map((axis) => [0, 1, 2, 3, 4, 5, 6, 7].reduce((sum, i) => sum + box.corners[3 * i + axis], 0) / 8);

const place = (box) => isSolid(box) ? middle(box) : box.place;

class Scene {
  constructor(canvas, onHover) {
    Object.assign(this, { canvas, onHover, view: new View(), hits: [] });
    listen(this);
  }

  resize() {
    const { width, height } = this.canvas.getBoundingClientRect();
    const { view } = this;
    if (view.width > 1 && width) view.scale *= Math.min(width / view.width, height / view.height);
    Object.assign(view, { width, height });
  }

  draw(frame, layers, hover) {
    this.resize();
    const { view } = this;
    const ctx = this.ctx = sized(this.canvas, view.width, view.height);
    this.hits = [];
    this.labels = new Labels(ctx, view.width, view.height);
    this.grid();
    if (!frame) return;
    for (const { kind, cloud: number } of frame.clouds) {
      if (layers[kind]) kind === "radar" ? this.radar(cloud(number)) : this.lidar(cloud(number));
    }
    this.ego();
    if (layers.truth) frame.truth.forEach((box) => this.box("truth", box, hover));
    if (layers.detections) frame.detections.forEach((box) => this.box("detection", box, hover));
    if (layers.tracks) frame.tracks.forEach((box) => this.box("track", box, hover));
    if (layers.labels) this.names(layers);
  }

  path(points, close = false) {
    const { ctx } = this;
    ctx.beginPath();
    let pen = false;
    for (const p of points) {
      if (!p) pen = false;
      else if (pen) ctx.lineTo(p[0], p[1]);
      else { ctx.moveTo(p[0], p[1]); pen = true; }
    }
    if (close) ctx.closePath();
  }

  grid() {
    const { ctx, view } = this;
    ctx.lineWidth = 1;
    let last = null;
    const step = [5, 10, 20, 50].find((s) => s * view.scale > 52) || 100;
    for (let r = step; r <= 200; r += step) {
      const ring = Array.from({ length: 121 }, (_, i) => view.at(r * Math.cos(i * Math.PI / 60), r * Math.sin(i * Math.PI / 60), 0));
      this.path(ring);
      ctx.strokeStyle = "rgba(150,164,184,.22)";
      ctx.stroke();
      const p = view.at(r * Math.cos(.62), -r * Math.sin(.62), 0);
      if (p && !(last && Math.hypot(p[0] - last[0], p[1] - last[1]) < 26)) {
        last = p;
        ctx.font = `11px ${FONT}`;
        ctx.fillStyle = "rgba(172,184,202,.85)";
        ctx.textAlign = "center";
        ctx.textBaseline = "middle";
        ctx.fillText(`${r} m`, p[0], p[1]);
      }
    }
    ctx.strokeStyle = "rgba(150,164,184,.1)";
    for (let v = -200; v <= 200; v += step) {
      const along = Array.from({ length: 41 }, (_, i) => i * 10 - 200);
      this.path(along.map((u) => view.at(u, v, 0)));
      ctx.stroke();
      this.path(along.map((u) => view.at(v, u, 0)));
      ctx.stroke();
    }
  }

  lidar(points) {
    const { ctx, view } = this;
    for (let i = 0; i < points.length; i += 4) {
      const z = points[i + 2] / 100;
      const p = view.at(points[i] / 100, points[i + 1] / 100, z);
      if (!p) continue;
      const light = 92 + 80 * Math.min(1, Math.max(0, (z + 1.5) / 4));
      ctx.fillStyle = `rgb(${light - 8},${light},${light + 12})`;
      ctx.fillRect(p[0] - .65, p[1] - .65, 1.3, 1.3);
    }
  }

  radar(points) {
    const { ctx, view } = this;
    for (let i = 0; i < points.length; i += 4) {
      const p = view.at(points[i] / 100, points[i + 1] / 100, points[i + 2] / 100);
      if (!p) continue;
      ctx.fillStyle = points[i + 3] === NO_SPEED ? "rgba(196,176,120,.8)" : rgba(speedRgb(points[i + 3] / 100), .85);
      ctx.beginPath();
      ctx.arc(p[0], p[1], 1.7, 0, 7);
      ctx.fill();
    }
  }

  ego() {
    const { ctx, view } = this;
    this.path([[2.4, 0], [-1.2, 1.1], [-.5, 0], [-1.2, -1.1]].map(([x, y]) => view.at(x, y, 0)), true);
    ctx.fillStyle = "#f4f6f8";
    ctx.fill();
  }

  box(kind, box, hover) {
    if (!isSolid(box)) return this.spot(kind, box, hover);
    const { ctx, view } = this;
    const eight = Array.from({ length: 8 }, (_, i) => view.at(...corner(box, i)));
    const center = view.at(...middle(box));
    if (eight.includes(null) || !center) return undefined;
    const rgb = kind === "truth" ? [222, 228, 236] : sourceRgb(box.sources);
    const on = hover === box;
    this.path(BOTTOM.map((i) => eight[i]), true);
    ctx.fillStyle = rgba(rgb, kind === "detection" ? .26 : on ? .3 : .04);
    ctx.fill();
    ctx.strokeStyle = rgba(rgb, kind === "detection" ? .7 : box.ignore || box.predicted ? .6 : 1);
    ctx.lineWidth = (kind === "track" ? 2 : 1.1) + (on ? 1.4 : 0);
    ctx.setLineDash(kind === "truth" ? [5, 4] : box.predicted ? [2, 3] : []);
    if (view.tilt) {
      for (const [i, j] of EDGES) { this.path([eight[i], eight[j]]); ctx.stroke(); }
    } else ctx.stroke();
    ctx.setLineDash([]);
    if (kind !== "truth") this.heading(box, eight, rgb);
    if (kind === "track") this.arrow(box, rgb);
    return this.hits.push({ kind, box, x: center[0], y: center[1], top: Math.min(...eight.map((p) => p[1])), rgb });
  }

  // A 2D box that has a distance: a diamond on the ray through its middle.
  spot(kind, box, hover) {
    const p = box.place && this.view.at(...box.place);
    if (!p) return;
    const { ctx } = this;
    const rgb = kind === "truth" ? [222, 228, 236] : sourceRgb(box.sources);
    const r = hover === box ? 8 : 6;
    this.path([[p[0], p[1] - r], [p[0] + r, p[1]], [p[0], p[1] + r], [p[0] - r, p[1]]], true);
    ctx.fillStyle = rgba(rgb, kind === "detection" ? .26 : .1);
    ctx.fill();
    ctx.strokeStyle = rgba(rgb, kind === "detection" || box.predicted ? .7 : 1);
    ctx.lineWidth = kind === "track" ? 2 : 1.1;
    ctx.setLineDash(kind === "truth" ? [3, 2] : box.predicted ? [2, 3] : []);
    ctx.stroke();
    ctx.setLineDash([]);
    if (kind === "track") this.arrow(box, rgb);
    this.hits.push({ kind, box, x: p[0], y: p[1], top: p[1] - r, rgb });
  }

  heading(box, eight, rgb) {
    const { ctx } = this;
    const mid = (i, j) => [(eight[i][0] + eight[j][0]) / 2, (eight[i][1] + eight[j][1]) / 2];
    const [front, rear] = [mid(4, 6), mid(5, 7)];
    this.path([[(front[0] + rear[0]) / 2, (front[1] + rear[1]) / 2], front]);
    ctx.strokeStyle = rgba(rgb, .8);
    ctx.stroke();
  }

  // One second of travel.
  arrow(box, rgb) {
    if (!known(box.speed) || !box.velocity || Math.abs(box.speed) < .5) return;
    const { ctx, view } = this;
    const [x, y, height] = place(box);
    const z = isSolid(box) ? box.corners[14] : height;
    const [a, b] = [view.at(x, y, z), view.at(x + box.velocity[0], y + box.velocity[1], z)];
    if (!a || !b) return;
    const angle = Math.atan2(b[1] - a[1], b[0] - a[0]);
    const tip = (turn) => [b[0] - 8 * Math.cos(angle + turn), b[1] - 8 * Math.sin(angle + turn)];
    ctx.lineWidth = 1.6;
    ctx.strokeStyle = ctx.fillStyle = rgba(rgb);
    this.path([a, b]);
    ctx.stroke();
    this.path([b, tip(.42), tip(-.42)], true);
    ctx.fill();
  }

  names(layers) {
    const tracks = this.hits.filter((hit) => hit.kind === "track");
    const named = tracks.length || !layers.detections ? tracks : this.hits.filter((hit) => hit.kind === "detection");
    const { width, height } = this.view;
    const near = named.filter((hit) => hit.x > 0 && hit.x < width && hit.y > 0 && hit.y < height).sort((a, b) => (a.box.distance || 0) - (b.box.distance || 0));
    for (const hit of near) this.labels.put(boxText(hit.box), hit.x, hit.top, hit.rgb);
  }
}

function nearest(hits, x, y) {
  const rank = { track: 0, detection: 1, truth: 2 };
  const close = hits.map((hit) => ({ hit, d: Math.hypot(hit.x - x, hit.y - y) + rank[hit.kind] * 3 })).filter(({ d }) => d < 24);
  return close.sort((a, b) => a.d - b.d)[0]?.hit;
}

// Drag, wheel, pinch and hover on the scene.
function listen(scene) {
  const { canvas, view } = scene;
  const fingers = new Map();
  const spread = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a.x - b.x, a.y - b.y); };
  canvas.addEventListener("pointerdown", (event) => {
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    canvas.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) {
      const box = canvas.getBoundingClientRect();
      return scene.onHover(nearest(scene.hits, event.clientX - box.left, event.clientY - box.top), event);
    }
    const before = fingers.size === 2 ? spread() : 0;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 2) view.zoom(spread() / Math.max(1, before));
    else if (view.tilt && !event.shiftKey) {
      view.turn += dx * .006;
      view.tilt = Math.min(1.4, Math.max(.15, view.tilt - dy * .005));
    } else view.move(dx, dy);
    return scene.onHover(undefined, event);
  });
  canvas.addEventListener("pointerleave", (event) => scene.onHover(undefined, event));
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    view.zoom(Math.exp(-event.deltaY * .0014), event.clientX - box.left, event.clientY - box.top);
    scene.onHover(undefined, event);
  }, { passive: false });
}

// What the view from above shows at first: x from, x to, y to both sides [m]. Boxes far away don't widen it.
function extent(frames) {
  let [back, front, side] = [-8, 30, 16];
  for (const frame of frames) {
    for (const box of [...frame.truth, ...frame.tracks, ...frame.detections].filter(place)) {
      const [x, y] = place(box);
      if (x < -60 || x > 80 || Math.abs(y) > 45) continue;
      back = Math.min(back, x - 5);
      front = Math.max(front, x + 5);
      side = Math.max(side, Math.abs(y) + 4);
    }
  }
  return [back, front, side];
}
