// State and controls of the player.
const LAYERS = ["truth", "detections", "tracks", "trails", "lidar", "radar", "labels"];
const TRAIL_S = 3;
const MAX_PAUSE_S = 1; // Longer ones, as between segments, aren't waited for
const state = { run: 0, beside: null, at: 0, camera: null, hover: undefined, object: null, playing: false, clip: null, wanted: 0 };
const footages = data.runs.map((one) => new Footage(one));
const scenes = [];
const panels = [];
let waiting = null; // What the next paint of the screen draws: the scenes, or all

const run = () => data.runs[state.run];
const footage = () => footages[state.run];
const filter = () => ({ label: $("class").value, only: $("only").value, object: state.object });
const layers = () => Object.fromEntries(LAYERS.map((name) => [name, $(`show-${name}`).checked]));

// Run and position of what is shown on each side; the second one is at the moment of the first.
function sides() {
  const shown = [[state.run, state.at]];
  if (known(state.beside) && footages[state.beside].length) shown.push([state.beside, footages[state.beside].nearest(footage().time(state.at))]);
  return shown;
}

function look(side) {
  const { object } = state;
  return {
    layers: layers(), hover: state.hover, byOutcome: $("color").value === "outcome", mark: clipMark(side),
    opacity: (kind, box) => !object || isObject(object, kind, box) ? 1 : .3,
  };
}

// What the filter leaves of a frame, and its points.
function chosen(footage, frame) {
  const { label, only } = filter();
  const keep = (boxes) => boxes.filter((box) => (!label || box.label === label) && (!only || matches(box, only)));
  const [truth, detections, tracks] = [frame.truth, frame.detections, frame.tracks].map(keep);
  const { media } = frame;
  const holder = media.row === frame.index ? frame : footage.get(footage.rows.indexOf(media.row));
  const motion = holder && holder !== frame ? footage.motion(holder.pose, frame.pose) : null;
  const points = media.clouds.map(({ kind, cloud }) => ({ kind, motion, values: clouds.get(cloud, drawSoon) })).filter(({ values }) => values);
  return { ...frame, truth, detections, tracks, points };
}

// Tracks over the last seconds, as far as poses are known and frames are decoded.
function trails(footage, at, tracks) {
  const now = footage.get(at);
  const ours = new Map(tracks.filter((box) => known(box.id) && isSolid(box)).map((box) => [box.id, { box, places: [middle(box)] }]));
  if (!now?.pose || !ours.size) return [];
  for (let before = at - 1; before >= 0 && footage.time(at) - footage.time(before) <= TRAIL_S; before--) {
    if (footage.line.segment[footage.rows[before]] !== footage.line.segment[footage.rows[at]]) break;
    const frame = footage.get(before);
    const motion = frame && footage.motion(frame.pose, now.pose);
    if (!motion) break;
    const [c, s, dx, dy] = motion;
    for (const box of frame.tracks) {
      const trail = isSolid(box) && ours.get(box.id);
      if (!trail) continue;
      const [x, y, z] = middle(box);
      trail.places.push([c * x - s * y + dx, s * x + c * y + dy, z]);
    }
  }
  return [...ours.values()].filter(({ places }) => places.length > 1);
}

function draw(what = "all") {
  sides().forEach(([number, at], side) => {
    const frame = footages[number].length ? footages[number].get(at, drawSoon) : undefined;
    if (!frame && footages[number].length) return; // it is drawn when it is decoded
    const shown = frame && chosen(footages[number], frame);
    scenes[side].draw(shown, look(side), frame ? trails(footages[number], at, shown.tracks) : []);
    if (what === "all") panels[side].draw(data.runs[number], shown, state.camera, look(side));
  });
}

// Pointers move faster than the screen is painted.
function drawSoon(what = "all") {
  if (!waiting) requestAnimationFrame(() => { const now = waiting; waiting = null; draw(now); });
  waiting = waiting === "all" || what !== "scenes" ? "all" : "scenes";
}

// The view moved, what it shows did not.
function turn() {
  showTip("");
  drawSoon("scenes");
}

function hover(hit, event) {
  state.hover = hit?.box;
  showTip(hit && !hit.quiet ? boxDetails(hit.kind, hit.box) : "", event.clientX, event.clientY);
  for (const row of $("objects").rows) row.classList.toggle("on", known(row.box) && row.box === state.hover);
  drawSoon();
}

// Follow an object, or none: others are dim, and errors are its own.
function pick(hit) {
  state.object = hit && !(state.object && isObject(state.object, hit.kind, hit.box)) ? { kind: hit.kind, id: hit.box.id, box: hit.box } : null;
  const { object } = state;
  $("object").hidden = !object;
  if (object) $("object").textContent = `${object.kind}${known(object.id) ? ` #${object.id}` : ""} ×`;
  if (object) $("object").setAttribute("aria-label", `Stop following ${object.kind} ${object.id ?? ""}`);
  list();
  drawSoon();
}

function list() {
  const frame = footage().length ? footage().get(state.at) : undefined;
  if (!frame) return $("objects").replaceChildren();
  return listObjects($("objects"), chosen(footage(), frame), { on: state.hover, object: state.object, hover, pick });
}

function pickFrame(number, index) {
  if (!scenes.length) return;
  showRun(number, index);
  $("frames").scrollIntoView({ block: "start" });
}

function showRun(number, index) {
  const wanted = index ?? footage().rows[state.at] ?? 0;
  state.run = number;
  $("run").value = String(number);
  const { rows } = footage();
  $("frame").max = String(Math.max(0, rows.length - 1));
  const away = rows.map((row) => Math.abs(row - wanted));
  $("color").disabled = !run().timeline.errors;
  $("outcomes").hidden = !run().timeline.errors;
  if (!run().timeline.errors) $("color").value = "source";
  offerBeside();
  return showFrame(away.reduce((best, far, i) => far < away[best] ? i : best, 0));
}

// Runs of the same log can be shown beside each other.
function offerBeside() {
  const others = data.runs.map((one, i) => [one, i]).filter(([one, i]) => i !== state.run && one.log === run().log && one.frames.length);
  $("beside-pick").hidden = !others.length;
  if (!others.some(([, i]) => i === state.beside)) state.beside = null;
  $("beside").replaceChildren(new Option("nothing", ""), ...others.map(([one, i]) => new Option(short(one.label, 60), String(i))));
  $("beside").value = String(state.beside ?? "");
  showBeside();
}

function showBeside() {
  $("viewer").classList.toggle("two", known(state.beside));
  $("second").hidden = !known(state.beside);
  $("who").hidden = !known(state.beside);
  $("who").textContent = run().label;
  if (known(state.beside)) $("who-2").textContent = data.runs[state.beside].label;
}

async function showFrame(at) {
  const { rows, line } = footage();
  state.at = Math.min(Math.max(0, at), Math.max(0, rows.length - 1));
  const wanted = ++state.wanted;
  state.hover = undefined;
  showTip("");
  $("frame").value = String(state.at);
  $("back").disabled = state.at <= 0;
  $("next").disabled = state.at >= rows.length - 1;
  if (!rows.length) {
    $("where").textContent = "This run kept no frames.";
    list();
    strips.forEach((strip) => strip.draw(null));
    return draw();
  }
  const i = rows[state.at];
  const missing = line.missing.filter(([index]) => index === i).map(([, sensor, why]) => `${short(sensor, 30)} missing (${short(why, 40)})`);
  const failed = line.failed.filter(([index]) => index === i).map(([, why]) => `failed: ${short(why, 80)}`);
  const [missed, alarms] = errorsAt(footage(), i, "");
  const switches = line.errors?.switches[i];
  const errors = [missed ? `${missed} missed` : "", alarms ? `${alarms} false` : "", switches ? `${switches} switched` : ""].filter(Boolean);
  const words = [`Frame ${line.first + i} of ${line.t.length}`, fixed(line.t[i], 2, " s"), `segment ${line.segment[i]}`, ...errors, ...missing, ...failed, ...droppedWords(line, i)];
  $("where").textContent = (known(line.truth[i]) ? words : [...words, "no truth"]).join(" · ");
  $("frame").setAttribute("aria-valuetext", words.slice(0, 2).join(", "));
  drawErrors($("errors"), footage(), $("only").value, state.at);
  clearTimeout(state.strips); // All frames of all runs are much to draw
  if (!state.playing) state.strips = setTimeout(() => strips.forEach((strip, number) => strip.draw(number === state.run ? i : null)), 120);
  const frame = await footage().load(state.at);
  if (wanted !== state.wanted) return undefined; // meanwhile another one was asked for
  showCameras(frame);
  if (!state.playing) list();
  return draw();
}

function showCameras(now) {
  const names = [...new Set([...Object.keys(run().cameras), ...Object.keys(now.media.pictures)])].sort();
  if (!names.includes(state.camera)) state.camera = names.find((name) => known(now.media.pictures[name])) ?? names[0] ?? null;
  const shown = JSON.stringify([names, state.camera]);
  if (state.cameras !== shown) $("cameras").replaceChildren(...(names.length > 1 ? names.map(cameraButton) : []));
  state.cameras = shown;
  const flat = [...now.tracks, ...now.detections].some((box) => !isSolid(box) && !box.invalid);
  const what = names.length === 1 ? short(names[0], 40) : "";
  $("camera-note").textContent = [what, flat ? "this run’s boxes are 2D: the bird’s-eye view shows those with a distance, on the ray through their middle" : ""].filter(Boolean).join(" · ");
  for (const id of ["camera", "camera-2"]) $(id).parentElement.hidden = !names.length;
}

function cameraButton(name) {
  const button = element("button", short(name, 24));
  button.type = "button";
  button.setAttribute("aria-pressed", String(name === state.camera));
  button.addEventListener("click", () => { state.camera = name; showFrame(state.at); });
  return button;
}

function fit() {
  const [scene] = scenes;
  scene.resize();
  scene.view.turn = 0;
  const xy = state.clip?.mark.xy;
  scene.view.fit(xy ? [Math.min(-6, xy[0] - 8), Math.max(24, xy[0] + 12), Math.max(12, Math.abs(xy[1]) + 8)] : extent(footages.flatMap((one) => [...one.made.values()])));
  drawSoon();
}

function tilt() {
  const [{ view }] = scenes;
  view.tilt = view.tilt ? 0 : 1.0;
  $("tilt").setAttribute("aria-pressed", String(view.tilt > 0));
  fit();
}

// Play at the pace of the log, or of a multiple of it, to the end; a clip begins anew.
function play(on = !state.playing) {
  if (on === state.playing) return;
  state.playing = on;
  $("play").textContent = on ? "Pause" : "Play";
  $("play").setAttribute("aria-pressed", String(on));
  if (!on) return void showFrame(state.at);
  if (state.at >= footage().length - 1) showFrame(0);
  let [clock, last] = [footage().time(state.at), performance.now()];
  const tick = async () => {
    if (!state.playing) return;
    const now = performance.now();
    clock += Math.min(.1, Math.max(0, now - last) / 1000) * Number($("speed").value);
    last = now;
    const end = state.clip ? Math.min(state.clip.to, footage().length - 1) : footage().length - 1;
    let at = state.at;
    while (at < end && footage().time(at + 1) <= clock) at++;
    if (at < end && footage().time(at + 1) - footage().time(at) > MAX_PAUSE_S) clock = footage().time(++at);
    if (at !== state.at) await showFrame(at);
    if (at >= end && state.clip) { clock = footage().time(state.clip.from); await showFrame(state.clip.from); }
    else if (at >= end) return void play(false);
    if (at + 1 <= end) ahead(at + 1);
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
}

// Decode what is shown next.
function ahead(at) {
  for (const next of [at, at + 1, at + data.chunk].filter((one) => one < footage().length)) {
    const frame = footage().get(next);
    if (!frame) continue;
    frame.media.clouds.forEach(({ cloud }) => clouds.get(cloud));
    if (known(frame.media.pictures[state.camera])) pictures.get(frame.media.pictures[state.camera]);
  }
}

async function jump(direction) {
  const { wanted } = state;
  const at = await findError(footage(), state.at, direction, filter());
  if (wanted !== state.wanted) return undefined; // meanwhile another frame was asked for
  if (known(at)) return step(at);
  $("where").textContent = `No ${direction > 0 ? "later" : "earlier"} frame has such an error`;
  return undefined;
}

function step(at) {
  state.clip = null;
  play(false);
  return showFrame(at);
}

const KEYS = {
  ArrowLeft: () => step(state.at - 1), ArrowRight: () => step(state.at + 1), n: () => jump(1), p: () => jump(-1),
  o: tilt, " ": () => play(), Escape: () => { state.clip = null; pick(undefined); },
};

function onKey(event) {
  const act = KEYS[event.key.length > 1 ? event.key : event.key.toLowerCase()];
  const busy = event.key === " " ? "select, .scroll, button, input, summary, a" : "select, .scroll";
  if (!act || event.ctrlKey || event.metaKey || event.altKey || event.target.closest(busy)) return;
  event.preventDefault();
  act();
}

// A stretch of frames in which something changed, with a ring around it: see `Clip` in reports/html/scene.py.
function showClip(clip, first = false) {
  play(false);
  for (const button of document.querySelectorAll("[data-clip]")) button.setAttribute("aria-pressed", String(data.clips[Number(button.dataset.clip)] === clip));
  $("clip").textContent = clip.title;
  [state.run, state.beside] = [clip.runs[0], clip.runs[1] ?? null];
  showRun(clip.runs[0], clip.rows[0]);
  const { rows } = footage();
  const [from, to] = clip.rows.map((wanted) => rows.reduce((best, row, i) => Math.abs(row - wanted) < Math.abs(rows[best] - wanted) ? i : best, 0));
  state.clip = { ...clip, from, to };
  showFrame(Math.min(to, from + (clip.lead ?? 0))).then(fit);
  if (first) return; // nobody asked for motion
  $("viewer").scrollIntoView({ block: "start" });
  play(true);
}

// What a clip is about, on one side: the box by its kind and id, or the nearest one to where it was at first.
function clipMark(side) {
  if (!state.clip || !sides()[side]) return null;
  const { kind, id, xy, runs } = state.clip.mark;
  const [number, at] = sides()[side];
  if (!runs.includes(number)) return null;
  const boxes = footages[number].get(at)?.[kind] ?? [];
  const far = (box) => xy && place(box) ? Math.hypot(place(box)[0] - xy[0], place(box)[1] - xy[1]) : Infinity;
  const near = (best, box) => far(box) < far(best ?? {}) ? box : best;
  const box = known(id) ? boxes.find((one) => one.id === id) : boxes.filter((one) => far(one) < 5).reduce(near, undefined);
  return { box, xy: box ? place(box) : null };
}

function setUp() {
  const view = new View();
  for (const end of ["", "-2"]) {
    scenes.push(new Scene($(`scene${end}`), view, { hover, pick, turn }));
    panels.push(new CameraPanel($(`camera${end}`), hover, drawSoon));
  }
  const on = (id, kind, act) => $(id).addEventListener(kind, act);
  $("run").replaceChildren(...data.runs.map((one, i) => new Option(short(one.label, 60), String(i))));
  $("run-pick").hidden = data.runs.length < 2;
  $("class").replaceChildren(new Option("all", ""), ...data.labels.map((label) => new Option(short(label, 40), label)));
  $("class").parentElement.hidden = data.labels.length < 2;
  for (const button of document.querySelectorAll("[data-clip]")) button.addEventListener("click", () => showClip(data.clips[Number(button.dataset.clip)]));
  on("run", "change", (event) => showRun(Number(event.target.value)));
  on("beside", "change", (event) => { state.beside = event.target.value === "" ? null : Number(event.target.value); showBeside(); fit(); });
  on("frame", "input", (event) => step(Number(event.target.value)));
  on("back", "click", KEYS.ArrowLeft);
  on("next", "click", KEYS.ArrowRight);
  on("error-back", "click", KEYS.p);
  on("error-next", "click", KEYS.n);
  on("play", "click", () => play());
  on("object", "click", () => pick(undefined));
  on("errors", "click", (event) => step(Math.floor(event.offsetX / $("errors").clientWidth * footage().length)));
  for (const id of ["class", "only", "color"]) on(id, "change", () => { list(); drawErrors($("errors"), footage(), $("only").value, state.at); draw(); });
  LAYERS.forEach((name) => on(`show-${name}`, "change", () => draw()));
  on("in", "click", () => { view.zoom(1.3); turn(); });
  on("out", "click", () => { view.zoom(1 / 1.3); turn(); });
  on("fit", "click", fit);
  on("tilt", "click", tilt);
  document.addEventListener("keydown", onKey);
  $("sources").replaceChildren(element("span", "Sources"), ...sourceKeys());
  if (data.clips.length) return void showClip(data.clips[0], true);
  const first = Math.max(0, data.runs.findIndex((one) => one.frames.length));
  // Begin where something went wrong, if anything did.
  const worst = footages[first].rows.map((row) => errorsAt(footages[first], row, "").reduce((a, b) => a + b));
  showRun(first, footages[first].rows[Math.max(0, worst.indexOf(Math.max(...worst)))]).then(fit);
}

// C camera, L LiDAR, R radar, S stereo: those that occur, and always the three primaries.
function sourceKeys() {
  const seen = [...new Set([1, 2, 4, ...data.sources])].sort((a, b) => bitCount(a) - bitCount(b) || a - b);
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
