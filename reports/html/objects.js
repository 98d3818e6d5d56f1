// The boxes of one frame as a table: the same objects for eyes that prefer text.
function listObjects(body, frame, hover, onHover) {
  const rows = [["track", frame.tracks], ["detection", frame.detections], ["truth", frame.truth]]
    .flatMap(([kind, boxes]) => [...boxes].sort(byDistance).map((box) => objectRow(kind, box, hover, onHover)));
  if (!rows.length) {
    const row = element("tr");
    row.append(element("td", frame.labelled ? "Nothing was found, and nothing was there." : "Nothing was found."));
    row.firstChild.colSpan = 5;
    rows.push(row);
  }
  body.replaceChildren(...rows);
}

const byDistance = (a, b) => (a.distance ?? 1e9) - (b.distance ?? 1e9);

function objectRow(kind, box, hover, onHover) {
  const row = element("tr", "", hover === box ? "on" : "");
  const name = element("th");
  const swatch = element("i");
  swatch.style.background = kind === "truth" ? "transparent" : rgba(sourceRgb(box.sources));
  if (kind === "truth") swatch.style.border = "1.5px dashed var(--truth)";
  name.scope = "row";
  name.append(swatch, `${kind}${known(box.id) ? ` #${box.id}` : ""}${box.label ? ` · ${short(box.label, 40)}` : ""}`);
  if (box.predicted) name.append(element("span", " predicted", "quiet"));
  if (box.invalid) name.append(element("span", " invalid, not drawn", "quiet"));
  if (box.ignore) name.append(element("span", " ignored", "quiet"));
  const speed = known(box.speed) && !isSolid(box) ? `${speedText(box)} radial` : speedText(box) || "–";
  row.append(name, element("td", kind === "truth" ? "–" : sourceNames(box.sources)), element("td", fixed(box.score, 2), "n"),
    element("td", fixed(box.distance, 1, " m"), "n"), element("td", speed, "n"));
  row.addEventListener("pointerenter", (event) => onHover({ kind, box, quiet: true }, event));
  row.addEventListener("pointerleave", (event) => onHover(undefined, event));
  row.box = box;
  return row;
}
