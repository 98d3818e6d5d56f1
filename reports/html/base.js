// Small helpers. Text reaches the page through textContent only.
const parse = (id) => JSON.parse(document.getElementById(id).textContent);
const $ = (id) => document.getElementById(id);
const data = parse("data");
const times = $("times") ? parse("times") : []; // A comparison has none

function element(tag, text = "", className = "") {
  const node = document.createElement(tag);
  node.textContent = text;
  if (className) node.className = className;
  return node;
}

const known = (value) => value !== null && value !== undefined;
const fixed = (value, digits, unit = "") => known(value) ? value.toFixed(digits).replace("-", "−") + unit : "–";
const short = (text, length = 22) => text.length > length ? text.slice(0, length - 1) + "…" : text;

// C red, L green, R blue, mixed for combinations; stereo is amber and tints what it adds to.
const SOURCE_RGB = [
  [176, 184, 196], [255, 88, 80], [66, 214, 118], [255, 214, 64],
  [84, 140, 255], [236, 112, 244], [64, 216, 232], [250, 250, 250],
];
const STEREO_RGB = [255, 152, 48];

function sourceRgb(bits) {
  const rgb = SOURCE_RGB[bits & 7];
  if (!(bits & 8)) return rgb;
  return bits & 7 ? rgb.map((value, i) => (value + STEREO_RGB[i]) / 2) : STEREO_RGB;
}

// What became of a box, for people who don't see all colors (after Okabe and Ito).
const OUTCOME_RGB = { hit: [64, 200, 150], missed: [255, 130, 200], "false alarm": [255, 140, 50], invalid: [255, 140, 50], ignored: [140, 147, 158] };
const WRONG = ["missed", "false alarm", "invalid"];
const isWrong = (box) => WRONG.includes(box.outcome);

// Color of a box on the stage: by what became of it, or by the sensors that found it.
function boxRgb(kind, box, byOutcome) {
  if (byOutcome && box.outcome && !(kind === "truth" && box.outcome === "hit")) return OUTCOME_RGB[box.outcome];
  return kind === "truth" ? [222, 228, 236] : sourceRgb(byOutcome ? 0 : box.sources);
}

const rgba = (rgb, alpha = 1) => `rgba(${rgb.map(Math.round).join(",")},${alpha})`;
const sourceNames = (bits) => ["C", "L", "R", "S"].filter((_, i) => bits >> i & 1).join(" + ") || "–";

// Red receding, white at equal speed, blue approaching; full colour from 10 m/s on.
function speedRgb(speed) {
  const share = Math.min(1, Math.abs(speed) / 10);
  const end = speed > 0 ? [255, 60, 52] : [48, 116, 255];
  return end.map((value) => 255 + (value - 255) * share);
}

const isSolid = (box) => known(box.corners);

const speedText = (box) => known(box.speed) ? fixed(box.speed, 1, " m/s") : "";

function boxText(box) {
  const name = (known(box.id) ? `#${box.id} ` : "") + short(box.label);
  const sources = box.sources ? sourceNames(box.sources).replaceAll(" ", "") : "";
  return [name.trim(), speedText(box), known(box.distance) ? fixed(box.distance, 0, " m") : "", sources].filter(Boolean).join(" · ");
}

function boxDetails(kind, box) {
  const lines = [`${kind}${known(box.id) ? ` #${box.id}` : ""}${box.label ? ` · ${short(box.label, 60)}` : ""}`];
  if (known(box.distance)) lines.push(`distance ${fixed(box.distance, 1, " m")}`);
  if (known(box.speed)) lines.push(`${isSolid(box) ? "speed" : "range rate"} ${speedText(box)}`);
  if (known(box.score)) lines.push(`score ${fixed(box.score, 2)}`);
  if (box.sources) lines.push(`sources ${sourceNames(box.sources)}`);
  if (box.outcome) lines.push(box.outcome);
  if (box.predicted) lines.push("predicted, not measured");
  if (box.ignore) lines.push("ignored: neither hit nor miss");
  return lines.join("\n");
}

// Canvas with one unit a CSS pixel, sharp on dense screens.
function sized(canvas, width, height) {
  const ratio = window.devicePixelRatio || 1;
  const size = [width, height].map((side) => Math.max(1, Math.round(side * ratio)));
  if (canvas.width !== size[0]) canvas.width = size[0];
  if (canvas.height !== size[1]) canvas.height = size[1];
  const ctx = canvas.getContext("2d", { willReadFrequently: true }); // Points are written as pixels, which a GPU makes slower
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  return ctx;
}

const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Noto Sans', sans-serif";

// Labels that would cover each other step aside or stay away.
class Labels {
  constructor(ctx, width, height) {
    Object.assign(this, { ctx, width, height, taken: [] });
  }

  put(text, x, y, rgb) {
    const { ctx } = this;
    ctx.font = `500 11.5px ${FONT}`;
    const w = ctx.measureText(text).width + 10;
    const h = 17;
    const spots = [[-w / 2, -h - 3], [6, -h / 2], [-w - 6, -h / 2], [-w / 2, 6], [6, -h - 8], [-w - 6, 8]];
    for (const [dx, dy] of spots) {
      const box = [Math.min(Math.max(x + dx, 2), this.width - w - 2), Math.min(Math.max(y + dy, 2), this.height - h - 2), w, h];
      if (!this.taken.some((other) => overlap(box, other))) return this.draw(text, box, rgb);
    }
    return false;
  }

  draw(text, box, rgb) {
    const { ctx } = this;
    this.taken.push(box);
    ctx.fillStyle = "rgba(10,12,16,.82)";
    ctx.beginPath();
    ctx.roundRect(...box, 4);
    ctx.fill();
    ctx.fillStyle = rgba(rgb);
    ctx.textBaseline = "middle";
    ctx.textAlign = "left";
    ctx.fillText(text, box[0] + 5, box[1] + box[3] / 2 + .5);
    return true;
  }
}

const overlap = (a, b) => a[0] < b[0] + b[2] && b[0] < a[0] + a[2] && a[1] < b[1] + b[3] && b[1] < a[1] + a[3];

function showTip(text, x, y) {
  const tip = $("tip") || document.body.appendChild(Object.assign(element("div", "", "tip"), { id: "tip" }));
  tip.hidden = !text;
  if (!text) return;
  tip.textContent = text;
  const box = tip.getBoundingClientRect();
  const left = x + 16 + box.width > window.innerWidth ? x - box.width - 12 : x + 16;
  tip.style.transform = `translate(${Math.max(4, left)}px, ${Math.max(4, Math.min(y + 14, window.innerHeight - box.height - 4))}px)`;
}
