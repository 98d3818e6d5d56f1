// Curves with uPlot: detections over thresholds, and times. What is drawn comes from the page's data as it is.
const LINE_COLORS = ["--line0", "--line1", "--line2", "--line3", "--line4", "--line5"];
const DASHES = [[], [7, 4], [2, 3], [10, 3, 2, 3]];
const WHOLE = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 50000];
const plots = [];
const lineColor = (i) => css(LINE_COLORS[i % LINE_COLORS.length]);
const lineDash = (i) => DASHES[Math.floor(i / LINE_COLORS.length) % DASHES.length];

// Lines on common axes; each line is {name, color, points: [[x...], [y...]], mark: [x, y]}. Redrawn with the page's width and colors.
function plot(id, lines, options) {
  const host = $(id);
  if (!host) return;
  const before = plots.find((one) => one.id === id);
  if (before) before.lines = lines;
  else plots.push({ id, host, lines, options });
  drawPlot(plots.find((one) => one.id === id));
}

function drawPlot(one) {
  one.chart?.destroy();
  one.chart = null;
  const lines = one.lines.filter((line) => line.points[0].length);
  one.host.classList.toggle("none", !lines.length);
  if (!lines.length) return;
  const axis = ({ label, whole }) => ({ label, labelSize: 20, size: 42, stroke: css("--quiet"), font: `11px ${FONT}`, labelFont: `11px ${FONT}`, grid: { stroke: css("--line"), width: 1 }, ticks: { stroke: css("--line") }, ...(whole ? { incrs: WHOLE } : {}) });
  const { x, y, limit, height = 230 } = one.options;
  one.chart = new uPlot({
    width: Math.max(180, one.host.clientWidth), height, legend: { show: false },
    cursor: { drag: { x: true, y: false }, points: { size: 6 } },
    scales: { x: { time: false, ...(x.range ? { range: x.range } : {}) }, y: { ...(y.range ? { range: y.range } : {}) } },
    axes: [axis(x), axis(y)],
    series: [{}, ...lines.map((line) => ({ label: line.name, stroke: lineColor(line.color), dash: lineDash(line.color), width: line.bars ? 1 : 1.8, spanGaps: !line.gaps, points: { show: line.points[0].length < 3 } }))],
    hooks: { draw: [(u) => marks(u, lines, limit)], setCursor: [(u) => pointAt(u, one, lines)] },
  }, uPlot.join(lines.map((line) => line.points)), one.host);
}

function marks(u, lines, limit) {
  const { ctx } = u;
  ctx.save();
  ctx.setLineDash([]);
  for (const line of lines) {
    if (!line.mark || line.mark.some((value) => !known(value))) continue;
    ctx.beginPath();
    ctx.arc(u.valToPos(line.mark[0], "x", true), u.valToPos(line.mark[1], "y", true), 4.5 * uPlot.pxRatio, 0, 2 * Math.PI);
    ctx.fillStyle = css("--card");
    ctx.strokeStyle = lineColor(line.color);
    ctx.lineWidth = 2 * uPlot.pxRatio;
    ctx.fill();
    ctx.stroke();
  }
  if (known(limit)) {
    const place = u.valToPos(limit.at, limit.axis, true);
    const { left, top, width, height } = u.bbox;
    ctx.beginPath();
    ctx.rect(left, top, width, height);
    ctx.clip();
    ctx.strokeStyle = css("--bad");
    ctx.setLineDash([4 * uPlot.pxRatio, 3 * uPlot.pxRatio]);
    ctx.beginPath();
    if (limit.axis === "x") { ctx.moveTo(place, top); ctx.lineTo(place, top + height); }
    else { ctx.moveTo(left, place); ctx.lineTo(left + width, place); }
    ctx.stroke();
  }
  ctx.restore();
}

function pointAt(u, one, lines) {
  const { left, top, idx } = u.cursor;
  if (left < 0 || !known(idx)) return showTip("");
  const x = u.data[0][idx];
  const at = lines.map((line, i) => [line, nearestKnown(u.data[i + 1], idx)]).filter(([, y]) => known(y));
  const box = u.over.getBoundingClientRect();
  const { x: ax } = one.options;
  return showTip([`${ax.label} ${round(x)}`, ...at.slice(0, 12).map(([line, y]) => `${short(line.name, 40)}  ${round(y)}`)].join("\n"), box.left + left, box.top + top);
}

const round = (value) => String(Math.round(value * 1000) / 1000).replace("-", "−");

function nearestKnown(values, idx) {
  for (let step = 0; step < 40; step++) {
    if (known(values[idx - step])) return values[idx - step];
    if (known(values[idx + step])) return values[idx + step];
  }
  return null;
}

// One y for each x, ascending: curves may stand on one x for a while.
function sortedBy(xs, ys, choose = Math.max) {
  const found = new Map();
  xs.forEach((x, i) => { if (known(x) && known(ys[i])) found.set(x, found.has(x) ? choose(found.get(x), ys[i]) : ys[i]); });
  const keys = [...found.keys()].sort((a, b) => a - b);
  return [keys, keys.map((x) => found.get(x))];
}

function keyOf(id, lines) {
  $(id)?.replaceChildren(...lines.map((line) => {
    const item = element("span");
    const swatch = document.createElementNS("http://www.w3.org/2000/svg", "svg");
    const stroke = document.createElementNS("http://www.w3.org/2000/svg", "line");
    swatch.setAttribute("class", `stroke line${line.color % LINE_COLORS.length}`);
    for (const [name, value] of Object.entries({ x1: 0, x2: 26, y1: 4, y2: 4, "stroke-dasharray": lineDash(line.color).join(" ") || "none" })) stroke.setAttribute(name, value);
    swatch.append(stroke);
    item.append(swatch, short(line.name, 50));
    return item;
  }));
}

function drawTimes(rows) {
  if (!$("plot-times")) return;
  const shown = rows.filter((row) => times[row]?.total.length).slice(0, 24);
  const budget = shown.map((row) => times[row].budget).find(known);
  const fromZero = (u, low, high) => [0, 1.04 * Math.max(high, budget ?? 0)];
  const warm = (row) => times[row].total.map((ms, i) => (i < times[row].warm_up ? null : ms));
  const lines = shown.map((row, color) => {
    const sorted = warm(row).filter(known).sort((a, b) => a - b);
    return { name: data.runs[row].label, color, points: sortedBy(sorted, sorted.map((_, i) => 100 * (i + 1) / sorted.length)) };
  });
  plot("plot-spread", lines, { x: { label: "ms", range: fromZero }, y: { label: "%", range: [0, 100] }, limit: known(budget) ? { axis: "x", at: budget } : undefined });
  const courses = shown.map((row, color) => ({ name: data.runs[row].label, color, gaps: true, points: [times[row].total.map((_, i) => i), warm(row)] }));
  plot("plot-times", courses, { x: { label: "frame", whole: true }, y: { label: "ms", range: fromZero }, limit: known(budget) ? { axis: "y", at: budget } : undefined });
  keyOf("times-key", lines.length > 1 ? lines : []);
}
