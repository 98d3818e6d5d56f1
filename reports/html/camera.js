// The camera image with boxes. Outlines come in pixels of the camera model and are scaled to the picture.
class CameraPanel {
  constructor(canvas, onHover, redraw) {
    Object.assign(this, { canvas, redraw, hits: [] });
    canvas.addEventListener("pointermove", (event) => {
      const box = canvas.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      const inside = this.hits.filter(({ r }) => x >= r[0] && x <= r[2] && y >= r[1] && y <= r[3]);
      onHover(inside.sort((a, b) => area(a.r) - area(b.r))[0], event);
    });
    canvas.addEventListener("pointerleave", (event) => onHover(undefined, event));
  }

  draw(run, frame, name, look) {
    const { layers } = look;
    Object.assign(this, { hits: [], look });
    const number = frame?.media.pictures[name];
    const image = known(number) ? pictures.get(number, this.redraw) : null;
    if (image) this.last = image;
    // While the next picture is decoded the last one stays.
    const latest = image ?? (known(number) ? this.last : null);
    const ready = latest && latest.naturalWidth ? latest : null;
    const [w, h] = ready ? [ready.naturalWidth, ready.naturalHeight] : run.cameras[name] || [16, 9];
    const width = this.canvas.parentElement.clientWidth;
    const height = Math.min(width * h / w, 720);
    this.canvas.style.height = `${height}px`;
    const ctx = this.ctx = sized(this.canvas, width, height);
    const fit = Math.min(width / w, height / h);
    const left = (width - w * fit) / 2;
    if (ready) ctx.drawImage(ready, left, 0, w * fit, h * fit);
    else this.say(known(number) ? "" : "No image of this camera in this frame", width, height / 2);
    if (!frame) return;
    if (ready && frame.media.row !== frame.index) this.say(`image of frame ${run.timeline.first + frame.media.row}`, width, height - 10);
    const model = frame.cameras[name] || [w, h];
    this.map = [left, w * fit / model[0], h * fit / model[1]];
    this.labels = new Labels(ctx, width, height);
    if (layers.truth) frame.truth.forEach((box) => this.box("truth", box, name));
    if (layers.detections) frame.detections.forEach((box) => this.box("detection", box, name));
    if (layers.tracks) frame.tracks.forEach((box) => this.box("track", box, name));
    if (layers.labels) this.names(layers);
  }

  say(text, width, y) {
    const { ctx } = this;
    ctx.fillStyle = "#d0d5dc";
    ctx.font = `13px ${FONT}`;
    ctx.textAlign = "center";
    ctx.fillText(text, width / 2, y);
  }

  // Pixel centres are at integers, canvas coordinates count from the corner.
  at(u, v) {
    const [left, sx, sy] = this.map;
    return [left + (u + .5) * sx, (v + .5) * sy];
  }

  box(kind, box, name) {
    const outline = box.seen[name];
    if (!outline) return;
    const { ctx, look } = this;
    const rgb = boxRgb(kind, box, look.byOutcome);
    const on = look.hover === box;
    ctx.globalAlpha = look.opacity(kind, box);
    const r = [...this.at(outline.rect[0], outline.rect[1]), ...this.at(outline.rect[2], outline.rect[3])];
    ctx.strokeStyle = rgba(rgb, kind === "detection" ? .75 : box.ignore || box.predicted ? .6 : .95);
    ctx.lineWidth = (kind === "track" ? 2 : 1.2) + (on ? 1.2 : 0);
    ctx.setLineDash(kind === "truth" ? [5, 4] : box.predicted ? [2, 3] : []);
    if (kind === "detection" || on) {
      ctx.fillStyle = rgba(rgb, on ? .24 : .12);
      ctx.fillRect(r[0], r[1], r[2] - r[0], r[3] - r[1]);
    }
    if (outline.curves) this.curves(outline.curves);
    else outline.wire ? this.wire(outline.wire) : ctx.strokeRect(r[0], r[1], r[2] - r[0], r[3] - r[1]);
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    if (look.mark?.box === box) {
      ctx.strokeStyle = "#ffe14d";
      ctx.lineWidth = 3;
      ctx.strokeRect(r[0] - 4, r[1] - 4, r[2] - r[0] + 8, r[3] - r[1] + 8);
    }
    this.hits.push({ kind, box, r, rgb });
  }

  // Edges of a box as a lens bends them.
  curves(edges) {
    const { ctx } = this;
    ctx.beginPath();
    for (const uv of edges) {
      ctx.moveTo(...this.at(uv[0], uv[1]));
      for (let i = 2; i < uv.length; i += 2) ctx.lineTo(...this.at(uv[i], uv[i + 1]));
    }
    ctx.stroke();
  }

  wire(uv) {
    const { ctx } = this;
    ctx.beginPath();
    for (const [i, j] of EDGES) {
      ctx.moveTo(...this.at(uv[2 * i], uv[2 * i + 1]));
      ctx.lineTo(...this.at(uv[2 * j], uv[2 * j + 1]));
    }
    ctx.stroke();
  }

  names(layers) {
    const named = namedHits(this.hits, layers, this.look);
    for (const { box, r, rgb } of named.sort((a, b) => isWrong(b.box) - isWrong(a.box) || area(b.r) - area(a.r))) {
      const score = known(box.score) ? ` · ${fixed(box.score, 2)}` : "";
      this.labels.put(boxText(box) + score, (r[0] + r[2]) / 2, r[1], rgb);
    }
  }
}

const area = (r) => (r[2] - r[0]) * (r[3] - r[1]);
