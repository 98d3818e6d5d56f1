// Contents that are decoded when they are shown: JPEG, points and boxes, one a line of base64. See reports/html/scene.py.
const lines = $("store").textContent.split("\n");
const bytesOf = (number) => Uint8Array.from(atob(lines[number]), (c) => c.charCodeAt(0));

async function inflate(number) {
  const stream = new Blob([bytesOf(number)]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Response(stream).arrayBuffer();
}

// Decoded contents by number, the latest `most` of them. `get` gives what is there, and calls `onReady` when it is.
class Decoded {
  constructor(most, decode) {
    Object.assign(this, { most, decode, found: new Map(), waiting: new Map() });
  }

  get(number, onReady) {
    const value = this.found.get(number);
    if (value !== undefined) {
      this.found.delete(number);
      this.found.set(number, value);
    } else this.load(number).then(onReady ?? (() => {}));
    return value;
  }

  load(number) {
    if (this.found.has(number)) return Promise.resolve(this.found.get(number));
    if (!this.waiting.has(number)) {
      this.waiting.set(number, this.decode(number).then((value) => {
        this.found.set(number, value);
        this.waiting.delete(number);
        if (this.found.size > this.most) this.found.delete(this.found.keys().next().value);
        return value;
      }));
    }
    return this.waiting.get(number);
  }
}

const boxChunks = new Decoded(64, async (number) => JSON.parse(new TextDecoder().decode(await inflate(number))));
const clouds = new Decoded(48, async (number) => new Int16Array(await inflate(number)));
const pictures = new Decoded(48, async (number) => {
  const image = new Image();
  image.src = "data:image/jpeg;base64," + lines[number];
  await image.decode().catch(() => {}); // what isn't a picture has no size, and isn't drawn
  return image;
});

const SIGNS = [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [-1, -1, 1], [1, 1, -1], [-1, 1, -1], [1, -1, -1], [-1, -1, -1]];

// Corners of [x, y, z, length, width, height, yaw, pitch, roll]: Rz(yaw) Ry(pitch) Rx(roll), as replay/geometry/iou.py.
function cornersOf([cx, cy, cz, length, width, height, yaw, pitch, roll]) {
  const turn = (a, b, angle) => [a * Math.cos(angle) - b * Math.sin(angle), a * Math.sin(angle) + b * Math.cos(angle)];
  return SIGNS.flatMap(([sx, sy, sz]) => {
    let [x, y, z] = [sx * length / 2, sy * width / 2, sz * height / 2];
    [y, z] = turn(y, z, roll);
    [z, x] = turn(z, x, pitch);
    [x, y] = turn(x, y, yaw);
    return [cx + x, cy + y, cz + z];
  });
}

function outlineOf(values, [width, height]) {
  if (!Array.isArray(values)) return { ...values, wire: null };
  if (values.length === 4) return { rect: values, wire: null };
  const [u, v] = [0, 1].map((side) => values.filter((_, i) => i % 2 === side));
  const inside = (value, most) => Math.min(Math.max(value, -.5), most - .5);
  const rect = [inside(Math.min(...u), width), inside(Math.min(...v), height), inside(Math.max(...u), width), inside(Math.max(...v), height)];
  return { rect, wire: values };
}

// A box with all that drawing needs; what the file leaves out is empty.
function unfold(box, outcome, sizes) {
  const whole = { label: "", id: null, score: null, sources: 0, seen: {}, ...box, outcome: outcome || "" };
  if (box.box) whole.corners = cornersOf(box.box);
  whole.seen = Object.fromEntries(Object.entries(whole.seen).map(([name, values]) => [name, outlineOf(values, sizes[name] ?? [1e9, 1e9])]));
  return whole;
}

// The frames of one run, by their position among those in the file.
class Footage {
  constructor(run) {
    Object.assign(this, { run, rows: run.frames, line: run.timeline, kept: new Map(run.media), made: new Map() });
  }

  get length() { return this.rows.length; }

  time(at) { return this.run.start + this.line.t[this.rows[at]]; }

  // The frame, or undefined until it is decoded.
  get(at, onReady) {
    const [truth, results] = this.run.chunks[Math.floor(at / data.chunk)].map((number) => boxChunks.get(number, onReady));
    return truth && results ? this.unfold(at, truth, results) : undefined;
  }

  async load(at) {
    const both = this.run.chunks[Math.floor(at / data.chunk)].map((number) => boxChunks.load(number));
    return this.unfold(at, ...await Promise.all(both));
  }

  unfold(at, truth, results) {
    if (!this.made.has(at)) {
      const [row, i] = [this.rows[at], at % data.chunk];
      const { outcomes, cameras, switched, ...rest } = results[i];
      const sides = ["detections", "tracks"].map((name) => [name, rest[name].map((box) => unfold(box, box.outcome, cameras))]);
      const boxes = truth[i].map((box, n) => ({ ...unfold(box, outcomes[n], cameras), switched: switched.includes(box.id) }));
      this.made.set(at, { ...rest, ...Object.fromEntries(sides), index: row, cameras, truth: boxes, media: this.media(row) });
      if (this.made.size > 400) this.made.delete(this.made.keys().next().value);
    }
    return this.made.get(at);
  }

  // Pictures and points of a frame, or those of the nearest one of its segment, at most a second away.
  media(row) {
    const { t, segment } = this.line;
    const near = [...this.kept.keys()].filter((other) => segment[other] === segment[row] && Math.abs(t[other] - t[row]) <= 1);
    near.sort((a, b) => Math.abs(t[a] - t[row]) - Math.abs(t[b] - t[row]) || a - b);
    return near.length ? { row: near[0], ...this.kept.get(near[0]) } : { row, pictures: {}, clouds: [] };
  }

  // Position of the frame nearest to a moment [s].
  nearest(moment) {
    let [low, high] = [0, this.length - 1];
    while (low < high) {
      const middle = Math.floor((low + high) / 2);
      if (this.time(middle) < moment) low = middle + 1;
      else high = middle;
    }
    return low > 0 && moment - this.time(low - 1) <= this.time(low) - moment ? low - 1 : low;
  }

  // Where what was at (x, y) in the body of another frame is in that of this one: [cos, sin, x, y]; null if unknown.
  motion(from, to) {
    if (!from || !to) return null;
    const [c, s] = [Math.cos(to[2]), Math.sin(to[2])];
    const [dx, dy] = [from[0] - to[0], from[1] - to[1]];
    return [Math.cos(from[2] - to[2]), Math.sin(from[2] - to[2]), c * dx + s * dy, c * dy - s * dx];
  }
}
