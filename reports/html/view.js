// The camera that looks at the scene: from straight above, or tilted and turned with perspective.
class View {
  constructor() {
    Object.assign(this, { x: 20, y: 0, scale: 8, tilt: 0, turn: 0, width: 1, height: 1 });
  }

  // Show x from `rear` to `front` and y to `wide` on both sides [m]; tilted, mostly what is ahead.
  fit([rear, front, wide]) {
    const [back, side] = this.tilt ? [Math.max(rear, -12), Math.min(wide, 26)] : [rear, wide];
    const span = front - back;
    this.scale = Math.min(this.height / span, this.width / (2 * side));
    [this.x, this.y] = [(front + back) / 2, 0];
    if (this.tilt) [this.x, this.scale] = [back + span * .42, this.scale * 1.25];
  }

  // Body coordinates [m] to canvas [px]; null behind the viewer.
  at(x, y, z) {
    const [c, s] = [Math.cos(this.turn), Math.sin(this.turn)];
    const [dx, dy] = [x - this.x, y - this.y];
    const forward = c * dx + s * dy;
    const left = c * dy - s * dx;
    const [ct, st] = [Math.cos(this.tilt), Math.sin(this.tilt)];
    const away = 1 + st * (forward * st - z * ct) / (1.1 * this.height / this.scale);
    if (away < .12) return null;
    const k = this.scale / away;
    return [this.width / 2 - left * k, this.height / 2 - (forward * ct + z * st) * k, k];
  }

  move(dx, dy) {
    const [c, s] = [Math.cos(this.turn), Math.sin(this.turn)];
    const forward = dy / this.scale / Math.max(.35, Math.cos(this.tilt));
    const left = dx / this.scale;
    this.x += c * forward - s * left;
    this.y += s * forward + c * left;
  }

  // Zoom by `factor`; what lies under (px, py) stays there in the view from above.
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const scale = Math.min(160, Math.max(.8, this.scale * factor));
    const kept = 1 - this.scale / scale;
    if (!this.tilt) this.move(-(px - this.width / 2) * kept, -(py - this.height / 2) * kept);
    this.scale = scale;
  }
}
