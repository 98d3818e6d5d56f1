// Points of a frame, written into pixels: some ten thousand of them take a few milliseconds without a GPU.
const NO_SPEED = -32768;
const pixel = ([r, g, b]) => (255 << 24 | Math.round(b) << 16 | Math.round(g) << 8 | Math.round(r)) >>> 0;
const HEIGHTS = Uint32Array.from({ length: 64 }, (_, i) => pixel([84 + 80 * i / 63, 92 + 80 * i / 63, 104 + 80 * i / 63]));
const SPEEDS = Uint32Array.from({ length: 65 }, (_, i) => pixel(speedRgb((i - 32) / 3.2)));
const SPEEDLESS = pixel([196, 176, 120]);

class PointLayer {
  // Draw clouds [{ kind, values, motion }] as `view` shows them; canvas pixels, `ratio` to one of CSS.
  draw(ctx, view, ratio, shown) {
    const { width, height } = ctx.canvas;
    if (!this.image || this.image.width !== width || this.image.height !== height) {
      this.image = ctx.createImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
    }
    this.pixels.fill(0);
    for (const cloud of shown) this.cloud(cloud, view, ratio, width, height);
    ctx.putImageData(this.image, 0, 0);
  }

  cloud({ kind, values, motion }, view, ratio, width, height) {
    const num = values.length / 4;
    const size = Math.max(1, Math.round((kind === "radar" ? 2.6 : 1.2) * ratio));
    const [mc, ms, mx, my] = motion ?? [1, 0, 0, 0];
    const [c, s, ct, st] = [Math.cos(view.turn), Math.sin(view.turn), Math.cos(view.tilt), Math.sin(view.tilt)];
    const depth = 1.1 * view.height / view.scale;
    const { pixels } = this;
    for (let i = 0; i < num; i++) {
      const px = values[i] / 100;
      const py = values[num + i] / 100;
      const z = values[2 * num + i] / 100;
      const dx = mc * px - ms * py + mx - view.x;
      const dy = ms * px + mc * py + my - view.y;
      const forward = c * dx + s * dy;
      const away = 1 + st * (forward * st - z * ct) / depth;
      if (away < .12) continue;
      const k = view.scale / away;
      const x = Math.round((view.width / 2 - (c * dy - s * dx) * k) * ratio - size / 2);
      const y = Math.round((view.height / 2 - (forward * ct + z * st) * k) * ratio - size / 2);
      if (x < 0 || y < 0 || x + size > width || y + size > height) continue;
      const speed = values[3 * num + i];
      const color = kind !== "radar" ? HEIGHTS[Math.max(0, Math.min(63, Math.round((z + 1.5) * 16)))]
        : speed === NO_SPEED ? SPEEDLESS : SPEEDS[Math.max(0, Math.min(64, Math.round(speed / 31.25) + 32))];
      for (let row = 0, at = y * width + x; row < size; row++, at += width) for (let j = at; j < at + size; j++) pixels[j] = color;
    }
  }
}
