// The boxes of one frame as a table: the same objects for eyes that prefer text. `use`: what is hovered, which object is
// followed, and what happens on either.
function listObjects(body, frame, use) {
  const rows = [["track", frame.tracks], ["detection", frame.detections], ["truth", frame.truth]]
    .flatMap(([kind, boxes]) => [...boxes].sort(byDistance).map((box) => objectRow(kind, box, use)));
  if (!rows.length) {
    const row = element("tr");
    row.append(element("td", frame.labelled ? "Nothing was found, and nothing was there." : "Nothing was found."));
    row.firstChild.colSpan = 6;
    rows.push(row);
  }
  body.replaceChildren(...rows);
}

const byDistance = (a, b) => isWrong(b) - isWrong(a) || (a.distance ?? 1e9) - (b.distance ?? 1e9);

function objectRow(kind, box, use) {
  const row = element("tr", "", use.on === box ? "on" : "");
  const name = element("th");
  const button = element("button", "", "plain");
  const swatch = element("i");
  swatch.style.background = kind === "truth" ? "transparent" : rgba(sourceRgb(box.sources));
  if (kind === "truth") swatch.style.border = "1.5px dashed var(--truth)";
  name.scope = "row";
  button.type = "button";
  button.setAttribute("aria-pressed", String(Boolean(use.object && isObject(use.object, kind, box))));
  button.append(swatch, `${kind}${known(box.id) ? ` #${box.id}` : ""}${box.label ? ` · ${short(box.label, 40)}` : ""}`);
  button.addEventListener("click", () => use.pick({ kind, box }));
  name.append(button);
  if (box.predicted) name.append(element("span", " predicted", "quiet"));
  if (box.invalid) name.append(element("span", " invalid, not drawn", "quiet"));
  if (box.switched) name.append(element("span", " its track changes", "wrong"));
  if (box.ignore) name.append(element("span", " ignored", "quiet"));
  const speed = known(box.speed) && !isSolid(box) ? `${speedText(box)} radial` : speedText(box) || "–";
  row.append(name, element("td", box.outcome || "–", isWrong(box) ? "wrong" : ""), element("td", kind === "truth" ? "–" : sourceNames(box.sources)),
    element("td", fixed(box.score, 2), "n"), element("td", fixed(box.distance, 1, " m"), "n"), element("td", speed, "n"));
  row.addEventListener("pointerenter", (event) => use.hover({ kind, box, quiet: true }, event));
  row.addEventListener("pointerleave", (event) => use.hover(undefined, event));
  row.box = box;
  return row;
}
