"""The page of a comparison: what got worse first, where, and why, object by object."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias
from urllib.parse import quote

from markupsafe import Markup

from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.comparison import Comparison, ObjectChange, Row
from fbench.replay.runs.folder import Run
from fbench.reports.html.page import write_whole
from fbench.reports.html.records import DASH, PACKAGE, environment, island, number, read_script, read_style
from fbench.reports.html.scene import BUDGET_MB, PLAYER, Clip, scenes
from fbench.reports.html.scoreboard import PRIMARY, SPACES, VEHICLE, WHOLE

Pairs: TypeAlias = Mapping[str, tuple[Run | None, Run | None]]
"""Runs of base and head by the name of their cell; `None`: kept in a baseline file only."""
_MOST_CHANGES, _MOST_OBJECTS = 60, 100
_STEPS = (0.005, 0.02, 0.05)  # Of a change, from which on its color is stronger
_WORSE = ("LOST", "NEW FALSE ALARM", "NEW SWITCH")
_RANK = {"REGRESSED": 0, "gone": 1, "INCONCLUSIVE": 2, "null": 3, "changed": 4, "improved": 5, "new": 6}


@dataclass(frozen=True)
class Links:
    """Reports of both sides, as far as there are any."""

    base: Path | None
    head: Path | None


def write_comparison(comparison: Comparison, pairs: Pairs, names: tuple[str, str], links: Links, out: Path) -> None:
    """Write one page that loads nothing, equal byte by byte for equal comparisons. `names` are those of base and head.
    Raises ConfigError where `out` can't be written.
    """
    rows = [row for row in comparison.rows if row.class_ not in VEHICLES or row.gate]
    shown = [row for row in rows if row.gate or row.verdict in ("REGRESSED", "improved", "changed", "gone")]
    shown.sort(key=lambda row: (_RANK.get(row.verdict, 9), not row.gate, not row.metric.startswith("critical_")))
    whole, slices = (
        [row for row in shown if (bool(row.gate) or row.slice == "all") == is_whole] for is_whole in (True, False)
    )
    objects = sorted(comparison.objects, key=lambda o: o.kind not in _WORSE)  # What got worse first, else as it was
    stages = {d.cell: d.stage for d in comparison.divergences}
    clips, runs, of = _clips(comparison, objects[:_MOST_OBJECTS], pairs, names)
    scene = scenes([run for _, run in runs], [label for label, _ in runs], BUDGET_MB * 1e6, clips)
    shown_rows = [set(run["frames"]) for run in scene.content["runs"]]
    there = {n for n, clip in enumerate(scene.content["clips"]) if clip["rows"][0] in shown_rows[clip["runs"][0]]}
    text = environment(PACKAGE).get_template("comparison.html").render(
        c=comparison,
        names=names,
        level={"failed": "bad", "inconclusive": "warn"}.get(comparison.state, "info"),
        several=len({(row.pipeline, row.condition) for row in rows}) > 1,
        changes=[_change(row) for row in whole[:_MOST_CHANGES]],
        slices=[_change(row) for row in slices[:_MOST_CHANGES]],
        num_more=max(0, len(whole) - _MOST_CHANGES) + max(0, len(slices) - _MOST_CHANGES),
        num_same=len(rows) - len(shown),
        maps=_maps(rows),
        objects=[
            _object(change, stages, number if number in there else None)
            for change, number in zip(objects[:_MOST_OBJECTS], of, strict=True)
        ],
        scene=scene,
        budget_mb=BUDGET_MB,
        velocity_periods=[],
        script=read_script("base.js", *PLAYER),
        data=Markup(island(scene.content)),  # noqa: S704 - escaped by `island`
        store=Markup(scene.store.text),  # noqa: S704 - base64
        num_worse=sum(change.kind in _WORSE for change in objects),
        places=comparison.places,
        links=[(name, _relative(path, out)) for name, path in (("base", links.base), ("head", links.head)) if path],
        style=read_style("style.css", "summary.css", "comparison.css"),
    )  # fmt: skip
    write_whole(out, text.encode("utf-8"))


def _clips(
    comparison: Comparison, objects: Sequence[ObjectChange], pairs: Pairs, names: tuple[str, str]
) -> tuple[list[Clip], list[tuple[str, Run]], list[int | None]]:
    """Return a clip for each changed object whose runs are there, the runs that clips show with their labels, and the
    number of the clip of each object.
    """
    clips, runs, of = list[Clip](), dict[tuple[str, str], Run](), list[int | None]()
    for change in objects:
        sides = zip(names if names[0] != names[1] else ("base", "head"), pairs.get(change.cell, ()), strict=False)
        own = [(name, run) for name, run in sides if run is not None]
        of.append(len(clips) if own else None)
        if not own:
            continue
        for name, run in own:
            runs.setdefault((name, change.cell), run)
        kind: Literal["truth", "detections", "tracks"] = "truth"
        if comparison.without_labels:  # Changes are of tracks then
            kind = "tracks"
        elif change.kind == "NEW FALSE ALARM":
            kind = "detections"
        places = list(runs)
        shown = tuple(places.index((name, change.cell)) for name, _ in own)
        # Truth is the same on both sides; tracks and detections are those of one.
        of_head = change.kind in ("FOUND", "NEW FALSE ALARM")
        marked = shown if kind == "truth" else shown[-1:] if of_head else shown[:1]
        track_id = None if kind == "detections" else change.track_id
        clips.append(Clip(f"{change}", shown, change.frames, marked, kind, track_id, change.xy_m))
    several = len({cell for _, cell in runs}) > 1
    return clips, [(f"{name}: {cell}" if several else name, run) for (name, cell), run in runs.items()], of


def _relative(path: Path, out: Path) -> str:
    return quote(Path(os.path.relpath(path.absolute(), out.absolute().parent)).as_posix())


def _change(row: Row) -> dict[str, Any]:
    """One number as text; `at` are both places in percent, where it is from 0 to 1."""
    digits = 0 if row.metric in WHOLE or row.metric.startswith("critical_") else 3
    known = [value for value in (row.base, row.head) if value is not None]
    fits = row.unit == "1" and digits and all(0 <= value <= 1 for value in known) and len(known) == 2
    interval = "" if row.low is None or row.high is None else f"{number(row.low)} to {number(row.high)}"
    sign = "+" if row.delta is not None and row.delta > 0 else ""
    return {
        "row": row,
        "title": PRIMARY.get(row.metric, row.metric.replace("_", " ")),
        "base": number(row.base, digits),
        "head": number(row.head, digits),
        "delta": DASH if row.delta is None else f"{sign}{number(row.delta, digits)}",
        "interval": interval,
        "at": [round(100 * value, 2) for value in known] if fits else None,
        "level": {"REGRESSED": "bad", "gone": "bad", "improved": "good"}.get(row.verdict, "other"),
    }


def _maps(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the changes of F1 of all vehicles by pipeline and condition, a table a space, where there are several."""
    found = []
    for start, space in SPACES.items():
        own = [
            r for r in rows if (r.metric, r.class_, r.slice) == ("f1", VEHICLE, "all") and r.matching.startswith(start)
        ]
        conditions = list(dict.fromkeys(row.condition for row in own))
        of = {(row.pipeline, row.condition): row for row in own}
        if len(of) < 2:
            continue
        lines = [
            (pipeline, [_cell(of.get((pipeline, condition))) for condition in conditions])
            for pipeline in dict.fromkeys(row.pipeline for row in own)
        ]
        found.append({"space": space, "conditions": conditions, "lines": lines})
    return found


def _cell(row: Row | None) -> tuple[str, str, str]:
    """Text, class and title of a change."""
    if row is None or row.delta is None:
        return "", "", ""
    step = sum(abs(row.delta) >= limit for limit in _STEPS)
    kind = f"{'worse' if row.delta < 0 else 'better'}{step}" if step else ""
    text = f"{'+' if row.delta > 0 else ''}{number(100 * row.delta, 1)}"
    return text, kind, f"{row.values}, {row.verdict}"


def _object(change: ObjectChange, stages: Mapping[str, str], clip: int | None) -> dict[str, Any]:
    name = f"{change.label or 'object'}{'' if change.track_id is None else f' #{change.track_id}'}"
    when = f"{change.from_s:.1f} to {change.to_s:.1f} s" if change.to_s > change.from_s else f"{change.from_s:.1f} s"
    first, last = change.frames
    return {
        "change": change, "name": name, "when": when, "clip": clip, "is_worse": change.kind in _WORSE,
        "frames": f"frame {first}" if first == last else f"frames {first} to {last}",
        "stage": stages.get(change.cell, ""),
    }  # fmt: skip
