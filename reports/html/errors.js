// Errors over time as a strip above the slider, and the way from one to the next: misses, and false alarms or switches.
const errorsAt = (footage, row, only) => {
  const { errors } = footage.line;
  if (!errors) return [0, 0];
  if (only === "switch") return [0, errors.switches[row]];
  const alarms = Math.max(errors.alarms[row], errors.false_tracks[row]);
  return [only === "alarm" ? 0 : errors.missed[row], only === "missed" ? 0 : alarms];
};

function drawErrors(canvas, footage, only, shown) {
  const width = canvas.parentElement.clientWidth;
  const height = 30;
  const ctx = sized(canvas, width, height);
  if (!footage.length) return;
  const counts = footage.rows.map((row) => errorsAt(footage, row, only));
  const most = Math.max(1, ...counts.map(([missed, alarms]) => missed + alarms));
  const step = width / footage.length;
  const bar = (at, from, to, rgb) => {
    ctx.fillStyle = rgba(rgb);
    ctx.fillRect(at * step, height - 2 - to * (height - 4) / most, Math.max(1, step - (step > 4 ? 1 : 0)), (to - from) * (height - 4) / most);
  };
  counts.forEach(([missed, alarms], at) => {
    bar(at, 0, missed, OUTCOME_RGB.missed);
    bar(at, missed, missed + alarms, OUTCOME_RGB["false alarm"]);
  });
  ctx.fillStyle = css("--ink");
  ctx.fillRect((shown + .5) * step - 1, 0, 2, height);
}

const matches = (box, only) => only === "switch" ? Boolean(box.switched) : isWrong(box) && (!only || only === "wrong" || (only === "missed") === (box.outcome === "missed"));

// Whether a frame has an error that the filter leaves: of a class, a kind, an object.
function hasError(frame, { label, only, object }) {
  const sides = [["truth", frame.truth], ["detection", frame.detections], ["track", frame.tracks]];
  return sides.some(([kind, boxes]) => boxes.some((box) => matches(box, only) && (!label || box.label === label) && (!object || isObject(object, kind, box))));
}

const isObject = (object, kind, box) => kind === object.kind && (known(object.id) ? box.id === object.id : box === object.box);

// Position of the next frame with such an error, in a direction; null where there is none.
async function findError(footage, at, direction, filter) {
  for (let next = at + direction; next >= 0 && next < footage.length; next += direction) {
    const [missed, alarms] = errorsAt(footage, footage.rows[next], filter.only);
    if (missed + alarms === 0) continue;
    if (!filter.label && !filter.object) return next;
    if (hasError(await footage.load(next), filter)) return next;
  }
  return null;
}
