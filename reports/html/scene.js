// Bird's-eye and 3D view of one frame.
const EDGES = [];
for (let i = 0; i < 8; i++) for (const bit of [1, 2, 4]) if (!(i & bit)) EDGES.push([i, i | bit]);
const BOTTOM = [4, 5, 7, 6]; // corner i: bit 0 is rear, bit 1 right, bit 2 bottom
const corner = (box, i) => [box.corners[3 * i], box.corners[3 * i + 1], box.corners[3 * i + 2]];
const middle = (box) => [0, 1, 2].map((axis) => [0, 1, 2, 3, 4, 5, 6, 7].reduce((sum, i) => sum + box.corners[3 * i + axis], 0) / 8);

const place = (box) => isSolid(box) ? middle(box) : box.place;

class Scene {
  constructor(canvas, view, on) {
    Object.assign(this, { canvas, view, on, hits: [], points: new PointLayer() });
    listen(this);
  }

  resize() {
    const { width, height } = this.canvas.getBoundingClientRect();
    const { view } = this;
    if (view.width > 1 && width) view.scale *= Math.min(width / view.width, height / view.height);
    Object.assign(view, { width, height });
  }

  // `look`: layers, what is hovered, whether colors are of outcomes, which boxes are dim, and marks [x, y].
  draw(frame, look, trails = []) {
    this.resize();
    const { view } = this;
    const { layers } = look;
    this.look = look;
    const ctx = this.ctx = sized(this.canvas, view.width, view.height);
    this.hits = [];
    this.labels = new Labels(ctx, view.width, view.height);
    if (frame) this.points.draw(ctx, view, window.devicePixelRatio || 1, frame.points.filter(({ kind }) => layers[kind]));
    this.grid();
    if (!frame) return;
    this.ego();
    if (layers.trails) trails.forEach((trail) => this.trail(trail));
    if (layers.truth) frame.truth.forEach((box) => this.box("truth", box));
    if (layers.detections) frame.detections.forEach((box) => this.box("detection", box));
    if (layers.tracks) frame.tracks.forEach((box) => this.box("track", box));
    if (look.mark?.xy) this.mark(look.mark.xy);
    if (layers.labels) this.names(layers);
  }

  // Where a track was in the last seconds.
  trail({ box, places }) {
    const { ctx, view, look } = this;
    this.path(places.map((p) => view.at(...p)));
    ctx.lineWidth = 1.5;
    ctx.strokeStyle = rgba(boxRgb("track", box, look.byOutcome), .55 * look.opacity("track", box));
    ctx.stroke();
  }

  // A ring around what changed.
  mark([x, y]) {
    const p = this.view.at(x, y, 0);
    if (!p) return;
    const { ctx } = this;
    ctx.beginPath();
    ctx.arc(p[0], p[1], 22, 0, 7);
    ctx.lineWidth = 3;
    ctx.strokeStyle = "#ffe14d";
    ctx.stroke();
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

  ego() {
    const { ctx, view } = this;
    this.path([[2.4, 0], [-1.2, 1.1], [-.5, 0], [-1.2, -1.1]].map(([x, y]) => view.at(x, y, 0)), true);
    ctx.fillStyle = "#f4f6f8";
    ctx.fill();
  }

  box(kind, box) {
    if (!isSolid(box)) return this.spot(kind, box);
    const { ctx, view, look } = this;
    const eight = Array.from({ length: 8 }, (_, i) => view.at(...corner(box, i)));
    const center = view.at(...middle(box));
    if (eight.includes(null) || !center) return undefined;
    const rgb = boxRgb(kind, box, look.byOutcome);
    const on = look.hover === box;
    ctx.globalAlpha = look.opacity(kind, box);
    this.path(BOTTOM.map((i) => eight[i]), true);
    ctx.fillStyle = rgba(rgb, kind === "detection" ? .26 : on ? .3 : .04);
    ctx.fill();
    ctx.strokeStyle = rgba(rgb, kind === "detection" ? .7 : box.ignore || box.predicted ? .6 : 1);
    ctx.lineWidth = (kind === "track" || box.outcome === "missed" ? 2 : 1.1) + (on ? 1.4 : 0);
    ctx.setLineDash(kind === "truth" ? [5, 4] : box.predicted ? [2, 3] : []);
    if (view.tilt) {
      for (const [i, j] of EDGES) { this.path([eight[i], eight[j]]); ctx.stroke(); }
    } else ctx.stroke();
    ctx.setLineDash([]);
    if (kind !== "truth") this.heading(box, eight, rgb);
    if (kind === "track") this.arrow(box, rgb);
    ctx.globalAlpha = 1;
    return this.hits.push({ kind, box, x: center[0], y: center[1], top: Math.min(...eight.map((p) => p[1])), rgb });
  }

  // A 2D box that has a distance: a diamond on the ray through its middle.
  spot(kind, box) {
    const p = box.place && this.view.at(...box.place);
    if (!p) return;
    const { ctx, look } = this;
    const rgb = boxRgb(kind, box, look.byOutcome);
    const r = look.hover === box ? 8 : 6;
    ctx.globalAlpha = look.opacity(kind, box);
    this.path([[p[0], p[1] - r], [p[0] + r, p[1]], [p[0], p[1] + r], [p[0] - r, p[1]]], true);
    ctx.fillStyle = rgba(rgb, kind === "detection" ? .26 : .1);
    ctx.fill();
    ctx.strokeStyle = rgba(rgb, kind === "detection" || box.predicted ? .7 : 1);
    ctx.lineWidth = kind === "track" ? 2 : 1.1;
    ctx.setLineDash(kind === "truth" ? [3, 2] : box.predicted ? [2, 3] : []);
    ctx.stroke();
    ctx.setLineDash([]);
    if (kind === "track") this.arrow(box, rgb);
    ctx.globalAlpha = 1;
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
    const { width, height } = this.view;
    const near = namedHits(this.hits, layers, this.look).filter((hit) => hit.x > 0 && hit.x < width && hit.y > 0 && hit.y < height);
    near.sort((a, b) => isWrong(b.box) - isWrong(a.box) || (a.box.distance || 0) - (b.box.distance || 0));
    for (const hit of near) this.labels.put(boxText(hit.box), hit.x, hit.top, hit.rgb);
  }
}

// Boxes whose text is written: tracks, or detections where there are none, and all errors.
function namedHits(hits, layers, look) {
  const kind = hits.some((hit) => hit.kind === "track") || !layers.detections ? "track" : "detection";
  return hits.filter((hit) => look.opacity(hit.kind, hit.box) === 1 && (hit.kind === kind || (look.byOutcome && isWrong(hit.box))));
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
  let moved = 0;
  canvas.addEventListener("pointerdown", (event) => {
    moved = 0;
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    canvas.setPointerCapture(event.pointerId);
  });
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    const last = fingers.get(event.pointerId);
    if (!last) {
      const box = canvas.getBoundingClientRect();
      return scene.on.hover(nearest(scene.hits, event.clientX - box.left, event.clientY - box.top), event);
    }
    const before = fingers.size === 2 ? spread() : 0;
    const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
    moved += Math.abs(dx) + Math.abs(dy);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    if (fingers.size === 2) view.zoom(spread() / Math.max(1, before));
    else if (view.tilt && !event.shiftKey) {
      view.turn += dx * .006;
      view.tilt = Math.min(1.4, Math.max(.15, view.tilt - dy * .005));
    } else view.move(dx, dy);
    return scene.on.turn();
  });
  canvas.addEventListener("pointerleave", (event) => scene.on.hover(undefined, event));
  canvas.addEventListener("click", (event) => {
    const box = canvas.getBoundingClientRect();
    if (moved < 4) scene.on.pick(nearest(scene.hits, event.clientX - box.left, event.clientY - box.top));
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    const box = canvas.getBoundingClientRect();
    view.zoom(Math.exp(-event.deltaY * .0014), event.clientX - box.left, event.clientY - box.top);
    scene.on.turn();
  }, { passive: false });
}

// What the view from above shows at first: x from, x to, y to both sides [m]. Boxes far away don't widen it.
function extent(frames) {
  let [back, front, side] = [-8, 30, 16];
  for (const frame of frames) {
    for (const box of [...frame.truth, ...frame.tracks, ...frame.detections].filter(place)) {
      const [x, y] = place(box);
      if (box.ignore || x < -20 || x > 70 || Math.abs(y) > 30) continue;
      back = Math.min(back, x - 5);
      front = Math.max(front, x + 5);
      side = Math.max(side, Math.abs(y) + 4);
    }
  }
  return [back, front, side];
}
