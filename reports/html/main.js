// State and controls.
const state = { run: 0, at: 0, camera: null, hover: undefined };
const LAYERS = ["truth", "detections", "tracks", "lidar", "radar", "labels"];
const strips = data.runs.map((_, number) => new Strip(number, (index) => pickFrame(number, index)));
let scene = null;
let panel = null;
let waiting = false;

const run = () => data.runs[state.run];
const frame = () => run().frames[state.at];
const layers = () => Object.fromEntries(LAYERS.map((name) => [name, $(`show-${name}`).checked]));

function draw() {
  scene.draw(frame(), layers(), state.hover);
  panel.draw(run(), frame(), state.camera, layers(), state.hover);
}

// Pointers move faster than the screen is painted.
function drawSoon() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => { waiting = false; draw(); });
}

function hover(hit, event) {
  state.hover = hit?.box;
  showTip(hit && !hit.quiet ? boxDetails(hit.kind, hit.box) : "", event.clientX, event.clientY);
  for (const row of $("objects").rows) row.classList.toggle("on", known(row.box) && row.box === state.hover);
  drawSoon();
}

function pickFrame(number, index) {
  if (!scene) return;
  showRun(number, index);
  $("frames").scrollIntoView({ block: "start" });
}

function showRun(number, index) {
  const wanted = index ?? frame()?.index ?? 0;
  state.run = number;
  $("run").value = String(number);
  const { frames } = run();
  $("frame").max = String(Math.max(0, frames.length - 1));
  const distance = frames.map((f) => Math.abs(f.index - wanted));
  showFrame(Math.max(0, distance.indexOf(Math.min(...distance))));
}

function showFrame(at) {
  const { frames, timeline: line } = run();
  state.at = Math.min(Math.max(0, at), Math.max(0, frames.length - 1));
  state.hover = undefined;
  showTip("");
  $("frame").value = String(state.at);
  $("back").disabled = state.at <= 0;
  $("next").disabled = state.at >= frames.length - 1;
  const now = frame();
  if (!now) {
    $("where").textContent = "This run kept no frames.";
    $("objects").replaceChildren();
    strips.forEach((strip) => strip.draw(null));
    return draw();
  }
  const i = now.index;
  const missing = line.missing.filter(([index]) => index === i).map(([, sensor, why]) => `${short(sensor, 30)} missing (${short(why, 40)})`);
  const failed = line.failed.filter(([index]) => index === i).map(([, why]) => `failed: ${short(why, 80)}`);
  const words = [`Frame ${line.first + i} of ${line.t.length}`, fixed(line.t[i], 2, " s"), `segment ${line.segment[i]}`, ...missing, ...failed, ...droppedWords(line, i)];
  $("where").textContent = (now.labelled ? words : [...words, "no truth"]).join(" · ");
  $("frame").setAttribute("aria-valuetext", words.slice(0, 2).join(", "));
  showCameras(now);
  listObjects($("objects"), now, state.hover, hover);
  strips.forEach((strip, number) => strip.draw(number === state.run ? i : null));
  return draw();
}

function showCameras(now) {
  const names = [...new Set([...Object.keys(run().cameras), ...Object.keys(now.pictures)])].sort();
  if (!names.includes(state.camera)) state.camera = names.find((name) => known(now.pictures[name])) ?? names[0] ?? null;
  $("cameras").replaceChildren(...(names.length > 1 ? names.map(cameraButton) : []));
  const flat = [...now.tracks, ...now.detections].some((box) => !isSolid(box) && !box.invalid);
  const what = names.length === 1 ? short(names[0], 40) : "";
  $("camera-note").textContent = [what, flat ? "this run’s boxes are 2D: the bird’s-eye view shows those with a distance, on the ray through their middle" : ""].filter(Boolean).join(" · ");
  $("camera").parentElement.hidden = !names.length;
}

function cameraButton(name) {
  const button = element("button", short(name, 24));
  button.type = "button";
  button.setAttribute("aria-pressed", String(name === state.camera));
  button.addEventListener("click", () => { state.camera = name; showCameras(frame()); draw(); });
  return button;
}

function fit() {
  scene.resize();
  scene.view.turn = 0;
  scene.view.fit(extent(data.runs.flatMap((r) => r.frames)));
  draw();
}

function onKey(event) {
  const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  if (!step || event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, .scroll")) return;
  event.preventDefault();
  showFrame(state.at + step);
}

function setUp() {
  scene = new Scene($("scene"), hover);
  panel = new CameraPanel($("camera"), hover, draw);
  $("run").replaceChildren(...data.runs.map((r, i) => new Option(short(r.label, 60), String(i))));
  $("run-pick").hidden = data.runs.length < 2;
  $("run").addEventListener("change", (event) => showRun(Number(event.target.value)));
  $("frame").addEventListener("input", (event) => showFrame(Number(event.target.value)));
  $("back").addEventListener("click", () => showFrame(state.at - 1));
  $("next").addEventListener("click", () => showFrame(state.at + 1));
  LAYERS.forEach((name) => $(`show-${name}`).addEventListener("change", draw));
  $("in").addEventListener("click", () => { scene.view.zoom(1.3); draw(); });
  $("out").addEventListener("click", () => { scene.view.zoom(1 / 1.3); draw(); });
  $("fit").addEventListener("click", fit);
  $("tilt").addEventListener("click", () => {
    scene.view.tilt = scene.view.tilt ? 0 : 1.0;
    $("tilt").setAttribute("aria-pressed", String(scene.view.tilt > 0));
    fit();
  });
  document.addEventListener("keydown", onKey);
  $("sources").replaceChildren(element("span", "Sources"), ...sourceKeys());
  const first = data.runs.findIndex((r) => r.frames.length);
  fit();
  showRun(first, 0);
}

// C camera, L LiDAR, R radar, S stereo: those that occur, and always the three primaries.
function sourceKeys() {
  const boxes = data.runs.flatMap((r) => r.frames.flatMap((f) => [...f.detections, ...f.tracks]));
  const seen = [...new Set([1, 2, 4, ...boxes.map((box) => box.sources)])].sort((a, b) => bitCount(a) - bitCount(b) || a - b);
  const names = { 0: "unknown", 1: "C camera", 2: "L LiDAR", 4: "R radar", 8: "S stereo" };
  return seen.map((bits) => {
    const key = element("span");
    const swatch = element("i", "", "swatch");
    swatch.style.background = rgba(sourceRgb(bits));
    key.append(swatch, names[bits] ?? sourceNames(bits));
    return key;
  });
}

const bitCount = (bits) => [1, 2, 4, 8].filter((bit) => bits & bit).length;

function resized() {
  strips.forEach((strip) => strip.draw());
  if (scene) draw();
}

$("lines").replaceChildren(...strips.map((strip) => strip.node));
if ($("viewer")) setUp();
resized();
window.addEventListener("resize", resized);
window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", resized);
document.body.dataset.ready = "true";
