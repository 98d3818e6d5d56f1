// What scores are made of: curves over thresholds, worst frames, and objects with the tracks that followed them.
const details = $("details") ? parse("details") : { runs: [] };
const SVG = "http://www.w3.org/2000/svg";
const MOST_ROWS = 25;
let setting = 0;

const shownRuns = () => details.settings?.[setting] ?? data.runs.map((_, i) => i);

function drawCurves() {
  const class_ = $("curve-class").value;
  const rows = shownRuns().filter((row) => details.runs[row]).slice(0, 24);
  const found = rows.map((row, color) => ({ row, color, curve: details.runs[row].curves.find((one) => one.name === class_) })).filter(({ curve }) => curve);
  const line = ({ row, color, curve }, points, mark) => ({ name: data.runs[row].label, color, points, mark });
  const unit = [0, 1.02];
  plot("plot-pr", found.map((one) => line(one, sortedBy(one.curve.recall, one.curve.precision), [one.curve.working.recall, one.curve.working.precision])), { x: { label: "recall", range: unit }, y: { label: "precision", range: unit } });
  plot("plot-f1", found.map((one) => line(one, sortedBy(one.curve.threshold, one.curve.f1), [Math.min(...one.curve.threshold), one.curve.working.f1])), { x: { label: "threshold" }, y: { label: "F1", range: unit } });
  keyOf("curve-key", found.map((one) => line(one, [[], []])));
}

function drawDetail() {
  const row = Number($("detail-run").value);
  const own = details.runs[row] ?? { frames: { frame: [], tp: [], fp: [], fn: [] }, objects: [] };
  const { frame: at, tp, fp, fn } = own.frames;
  const errors = [{ name: "misses", color: 4, gaps: true, points: [at, fn] }, { name: "false alarms", color: 1, gaps: true, points: [at, fp] }];
  plot("plot-errors", errors, { x: { label: "frame", whole: true }, y: { label: "boxes", whole: true }, height: 150 });
  keyOf("errors-key", errors);
  const worst = at.map((_, i) => i).filter((i) => fn[i] + fp[i]).sort((a, b) => fn[b] + fp[b] - fn[a] - fp[a] || a - b).slice(0, 8);
  $("worst-frames").replaceChildren(...(worst.length ? worst.map((i) => worstRow(row, at[i], [fn[i], fp[i], tp[i]])) : [rowOf("No frame has an error.", [])]));
  $("gantt-note").textContent = own.objects.length ? `${own.objects.length} objects with an id, those that were missed most first.` : "No object of this run has an id, or the pipeline gives no tracks.";
  listObjectsOverTime(own, MOST_ROWS);
}

function rowOf(name, cells) {
  const node = element("tr");
  const head = element("th", name);
  head.scope = "row";
  node.append(head, ...cells.map((cell) => element("td", String(cell), "n")));
  return node;
}

function worstRow(row, frame, counts) {
  const node = rowOf("", counts);
  const button = element("button", `Frame ${frame}`, "link");
  button.type = "button";
  button.addEventListener("click", () => pickFrame(row, frame - data.runs[row].timeline.first));
  node.firstChild.append(button);
  return node;
}

function listObjectsOverTime(own, most) {
  const frames = own.frames.frame;
  const [first, last] = [frames[0], frames[frames.length - 1]];
  const rows = own.objects.slice(0, most).map((one) => objectOverTime(one, first, Math.max(1, last - first + 1)));
  if (own.objects.length > most) {
    const more = element("tr");
    const cell = element("td");
    const button = element("button", `Show all ${own.objects.length}`, "link");
    button.type = "button";
    button.addEventListener("click", () => listObjectsOverTime(own, Infinity));
    cell.colSpan = 5;
    cell.append(button);
    more.append(cell);
    rows.push(more);
  }
  $("gantt").replaceChildren(...rows);
}

function objectOverTime(one, first, num) {
  const where = [known(one.range_m) ? fixed(one.range_m, 0, " m") : "", one.camera ? short(one.camera, 16) : ""].filter(Boolean).join(", ");
  const node = rowOf(`${short(one.label, 16) || "object"} #${one.track_id}`, []);
  if (where) node.firstChild.append(element("span", ` ${where}`, "quiet"));
  const chart = document.createElementNS(SVG, "svg");
  chart.setAttribute("role", "img");
  chart.setAttribute("aria-label", `Missed in ${one.num_missed} of ${one.num_frames} frames, ${one.num_switches} switches, ${one.num_fragments} fragments`);
  const colors = new Map();
  let before = null;
  one.spans.forEach(([from, to, track]) => {
    const bar = document.createElementNS(SVG, "rect");
    const missed = !known(track);
    if (!missed && !colors.has(track)) colors.set(track, colors.size % 6);
    const place = { x: `${100 * (from - first) / num}%`, width: `${Math.max(.25, 100 * (to - from + 1) / num)}%`, y: missed ? 8 : 3, height: missed ? 4 : 14, class: missed ? "missed" : `line${colors.get(track)}` };
    for (const [name, value] of Object.entries(place)) bar.setAttribute(name, value);
    const title = document.createElementNS(SVG, "title");
    title.textContent = `frames ${from} to ${to}: ${missed ? "missed" : `track #${track}`}`;
    bar.append(title);
    chart.append(bar);
    if (!missed && before !== null && before !== track) chart.append(switchMark(100 * (from - first) / num));
    if (!missed) before = track;
  });
  const cell = element("td", "", "bar");
  cell.append(chart);
  node.append(cell, ...[one.num_missed, one.num_switches, one.num_fragments].map((value) => element("td", value ? String(value) : "", "n")));
  return node;
}

function switchMark(x) {
  const mark = document.createElementNS(SVG, "line");
  for (const [name, value] of Object.entries({ x1: `${x}%`, x2: `${x}%`, y1: 0, y2: 20, class: "switch" })) mark.setAttribute(name, value);
  return mark;
}

function showSetting(number) {
  setting = number;
  for (const node of document.querySelectorAll("[data-setting]")) node.hidden = Number(node.dataset.setting) !== number;
  drawTimes(shownRuns());
  if (!$("details")) return;
  if ($("detail-run").options.length > 1) $("detail-run").value = String(shownRuns()[0]);
  drawCurves();
  drawDetail();
}

function showMetric(name) {
  for (const node of document.querySelectorAll("[data-metric]")) node.hidden = node.dataset.metric !== name;
  for (const button of document.querySelectorAll("[data-show-metric]")) button.setAttribute("aria-pressed", String(button.dataset.showMetric === name));
}

function setUpDetails() {
  $("setting")?.addEventListener("change", (event) => showSetting(Number(event.target.value)));
  for (const button of document.querySelectorAll("[data-show-metric]")) button.addEventListener("click", () => showMetric(button.dataset.showMetric));
  if ($("details")) {
    const names = [...new Set(details.runs.flatMap((one) => (one ? one.curves.map((curve) => curve.name) : [])))];
    $("curve-class").replaceChildren(...names.map((name) => new Option(short(name, 60), name)));
    const num = (name) => details.runs.filter((one) => one?.curves.some((curve) => curve.name === name)).length;
    $("curve-class").value = names.reduce((best, name) => (num(name) > num(best) ? name : best), names[0] ?? "");
    $("curve-class").addEventListener("change", drawCurves);
    $("detail-run").addEventListener("change", drawDetail);
  }
  // The first picture is the summary; curves further down can wait for it.
  requestAnimationFrame(() => setTimeout(() => { showSetting(0); document.body.dataset.drawn = "true"; }));
  const redraw = () => plots.forEach(drawPlot);
  window.addEventListener("resize", redraw);
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}

setUpDetails();
