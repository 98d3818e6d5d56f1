// All frames of one run as a strip: counts, missing sensors, failures, segments and latency.
const PAD = 34;
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

// Why a frame has no output of its own, where the pipeline was too busy to get it.
const droppedWords = (line, i) => line.dropped.filter(([at]) => at === i).map(([, latest]) => (known(latest) ? `dropped: the output of frame ${line.first + latest} is the latest` : "dropped: no output is ready yet"));

class Strip {
  constructor(number, onPick) {
    const run = data.runs[number];
    Object.assign(this, { run, line: run.timeline, time: times[number], onPick, at: null });
    this.sensors = [...new Set(this.line.missing.map(([, sensor]) => sensor))].sort();
    this.kept = run.media.map(([row]) => row);
    this.shownRows = run.frames;
    this.total = this.time.total;
    this.node = element("div", "", "strip");
    this.canvas = element("canvas");
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", `Timeline of ${run.label}: ${this.summary()}`);
    this.note = element("output", this.summary());
    if (data.runs.length > 1) this.node.append(element("h3", run.label));
    this.node.append(this.canvas, this.note);
    this.canvas.addEventListener("pointermove", (event) => this.hover(event));
    this.canvas.addEventListener("pointerleave", () => { this.at = null; this.note.textContent = this.summary(); this.draw(); showTip(""); });
    this.canvas.addEventListener("click", (event) => this.pick(event));
  }

  summary() {
    const { line } = this;
    const span = line.t.length ? fixed(line.t[line.t.length - 1] - line.t[0], 1, " s") : "";
    return `${line.t.length} frames over ${span || "no time"}, ${line.missing.length} times a sensor was missing, ${line.failed.length} failed${line.dropped.length ? `, ${line.dropped.length} dropped` : ""}`;
  }

  index(event) {
    const box = this.canvas.getBoundingClientRect();
    const share = (event.clientX - box.left - PAD) / Math.max(1, box.width - 2 * PAD);
    return Math.min(this.line.t.length - 1, Math.max(0, Math.floor(share * this.line.t.length)));
  }

  hover(event) {
    if (!this.line.t.length) return;
    this.at = this.index(event);
    this.draw();
    showTip(this.describe(this.at), event.clientX, event.clientY);
    this.note.textContent = this.describe(this.at).split("\n").join(" · ");
  }

  pick(event) {
    const at = this.index(event);
    const near = [...this.shownRows].sort((a, b) => Math.abs(a - at) - Math.abs(b - at))[0];
    if (known(near)) this.onPick(near);
  }

  describe(i) {
    const { line } = this;
    const lines = [`frame ${i} · ${fixed(line.t[i], 2, " s")} · segment ${line.segment[i]}`];
    lines.push(`truth ${line.truth[i] ?? "–"}, detections ${line.detections[i] ?? "–"}, tracks ${line.tracks[i] ?? "–"}`);
    if (known(this.total[i])) lines.push(`latency ${fixed(this.total[i], 1, " ms")}${i < this.time.warm_up ? " (warm-up, not counted)" : ""}`);
    for (const [, sensor, why] of line.missing.filter(([at]) => at === i)) lines.push(`${short(sensor, 60)} missing: ${short(why, 120)}`);
    for (const [, why] of line.failed.filter(([at]) => at === i)) lines.push(`failed: ${short(why, 200)}`);
    lines.push(...droppedWords(line, i));
    return lines.join("\n");
  }

  draw(shown = this.shown) {
    this.shown = shown;
    const num = this.line.t.length;
    const width = this.node.clientWidth - 26;
    const rows = this.sensors.length + (this.line.failed.length ? 1 : 0) + (this.line.dropped.length ? 1 : 0);
    const [top, gap] = [88, 22];
    const latencyTop = top + gap + rows * 25 + 22;
    const height = latencyTop + (this.total.length ? 60 : 0) + 20;
    this.canvas.style.height = `${height}px`;
    const ctx = this.ctx = sized(this.canvas, width, height);
    if (!num) return;
    this.step = (width - 2 * PAD) / num;
    this.x = (i) => PAD + (i + .5) * this.step;
    ctx.font = `11px ${FONT}`;
    this.borders(height - 18);
    this.counts(12, top);
    this.marks(top + gap);
    if (this.total.length) this.latency(latencyTop, 54);
    this.axis(height, top);
  }

  text(text, x, y, align = "left", color = css("--quiet")) {
    this.ctx.fillStyle = color;
    this.ctx.textAlign = align;
    this.ctx.textBaseline = "middle";
    this.ctx.fillText(text, x, y);
  }

  borders(bottom) {
    const { ctx, line } = this;
    ctx.strokeStyle = css("--ink");
    ctx.lineWidth = 1;
    line.segment.forEach((segment, i) => {
      if (!i || segment === line.segment[i - 1]) return;
      ctx.globalAlpha = .45;
      ctx.beginPath();
      ctx.moveTo(this.x(i) - this.step / 2, 4);
      ctx.lineTo(this.x(i) - this.step / 2, bottom);
      ctx.stroke();
      ctx.globalAlpha = 1;
    });
    if (this.at !== null) {
      ctx.fillStyle = css("--soft");
      ctx.fillRect(this.x(this.at) - Math.max(1, this.step / 2), 2, Math.max(2, this.step), bottom);
    }
  }

  counts(top, bottom) {
    const { ctx, line } = this;
    const most = Math.max(1, ...["truth", "detections", "tracks"].map((name) => line[name].reduce((a, b) => Math.max(a, b ?? 0), 0)));
    const y = (count) => bottom - (bottom - top) * count / most;
    ctx.strokeStyle = css("--line");
    ctx.lineWidth = 1;
    for (const count of [0, most]) {
      ctx.beginPath();
      ctx.moveTo(PAD, y(count));
      ctx.lineTo(this.x(line.t.length - 1) + this.step / 2, y(count));
      ctx.stroke();
      this.text(String(count), PAD - 6, y(count), "right");
    }
    for (const name of ["truth", "detections", "tracks"]) {
      ctx.strokeStyle = css(`--${name}`);
      ctx.setLineDash(name === "truth" ? [4, 3] : []);
      ctx.lineWidth = name === "tracks" ? 1.8 : 1.4;
      this.series(line[name], y);
      ctx.setLineDash([]);
    }
  }

  // A line that breaks where there is no value and at segment borders.
  series(values, y) {
    const { ctx, line } = this;
    ctx.beginPath();
    values.forEach((value, i) => {
      if (!known(value)) return;
      const joined = i && known(values[i - 1]) && line.segment[i] === line.segment[i - 1];
      if (joined) ctx.lineTo(this.x(i), y(value));
      else {
        ctx.moveTo(this.x(i) - Math.min(2, this.step / 3), y(value));
        ctx.lineTo(this.x(i), y(value));
      }
    });
    ctx.stroke();
  }

  marks(top) {
    const { ctx, line } = this;
    const w = Math.max(1.5, this.step - 1);
    const row = (number, name, color, indices) => {
      const y = top + number * 25;
      this.text(name, PAD, y + 5);
      ctx.fillStyle = css("--soft");
      ctx.fillRect(PAD, y + 13, this.step * line.t.length, 8);
      ctx.fillStyle = css(color);
      for (const i of indices) ctx.fillRect(this.x(i) - w / 2, y + 13, w, 8);
    };
    this.sensors.forEach((sensor, n) => row(n, `${short(sensor, 28)} missing`, "--warn", line.missing.filter(([, s]) => s === sensor).map(([i]) => i)));
    if (line.failed.length) row(this.sensors.length, "pipeline failed", "--bad", line.failed.map(([i]) => i));
    if (line.dropped.length) row(this.sensors.length + (line.failed.length ? 1 : 0), "dropped: the pipeline was busy", "--quiet", line.dropped.map(([i]) => i));
  }

  latency(top, height) {
    const { ctx } = this;
    const sorted = this.total.filter(known).sort((a, b) => a - b);
    const budget = this.time.budget;
    const most = Math.max(budget ? budget * 1.15 : 1, sorted[Math.floor((sorted.length - 1) * .99)] * 1.1);
    const y = (ms) => top + height - height * Math.min(1, ms / most);
    const [calm, slow, first] = ["--p95", "--bad", "--line"].map(css);
    this.total.forEach((ms, i) => {
      if (!known(ms)) return;
      const over = known(budget) && ms > budget;
      ctx.fillStyle = i < this.time.warm_up ? first : over ? slow : calm;
      ctx.fillRect(this.x(i) - Math.max(1, this.step - 1) / 2, y(ms), Math.max(1, this.step - 1), top + height - y(ms));
    });
    this.text("latency, ms", PAD, top - 9);
    this.text("0", PAD - 6, top + height, "right");
    if (!known(budget)) return this.text(String(Math.round(most)), PAD - 6, top, "right");
    ctx.strokeStyle = css("--bad");
    ctx.setLineDash([3, 2]);
    ctx.beginPath();
    ctx.moveTo(PAD, y(budget));
    ctx.lineTo(PAD + this.step * this.total.length, y(budget));
    ctx.stroke();
    ctx.setLineDash([]);
    return this.text(String(Math.round(budget)), PAD - 6, y(budget), "right");
  }

  axis(height, bottom) {
    const { ctx, line } = this;
    const num = line.t.length;
    for (const share of [0, .25, .5, .75, 1]) {
      const i = Math.round((num - 1) * share);
      this.text(share && share < 1 ? `${i}` : `frame ${i}`, this.x(i), height - 7, "center");
      if (num < 5) break;
    }
    for (const i of this.kept) {
      const on = i === this.shown;
      const size = on ? 5 : 3.5;
      ctx.fillStyle = css(on ? "--ink" : "--accent");
      ctx.beginPath();
      ctx.moveTo(this.x(i), bottom + 4);
      ctx.lineTo(this.x(i) - size, bottom + 5 + size * 1.6);
      ctx.lineTo(this.x(i) + size, bottom + 5 + size * 1.6);
      ctx.fill();
    }
  }
}
