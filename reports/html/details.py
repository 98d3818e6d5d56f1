"""Details of scores for the scripts that draw them, as the run folders hold them."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from fbench.replay.data.details import Details, ScoreCurve, load_details
from fbench.replay.runs.folder import Run
from fbench.reports.html.scoreboard import SPACES, Setting


def details_of(runs: Sequence[Run], settings: Sequence[Setting], class_: str) -> dict[str, Any]:
    """Return curves, errors by frame and objects of each run, `None` where it has none, and the runs of settings."""
    own = [load_details(run.folder) for run in runs]
    found = [None if one is None else _content(run, one) for run, one in zip(runs, own, strict=True)]
    return {"settings": [list(setting.rows) for setting in settings], "class": class_, "runs": found}


def _content(run: Run, details: Details) -> dict[str, Any]:
    objects = [
        {**{name: value for name, value in vars(one).items() if name != "spans"},
         "spans": [(span.first_frame, span.last_frame, span.track_id) for span in one.spans]}
        for one in details.objects
    ]  # fmt: skip
    curves = [_curve(run, curve) for curve in details.curves]
    return {"curves": curves, "objects": objects, "frames": asdict(details.frames)}


def _curve(run: Run, curve: ScoreCurve) -> dict[str, Any]:
    """A curve by the name of its class and space, with the working point as the scores have it."""
    own = {s.metric: s.value for s in run.scores if s.key[1:] == (curve.class_, "all", curve.matching)}
    space = next((name for start, name in SPACES.items() if curve.matching.startswith(start)), curve.matching)
    lines = {name: list(getattr(curve, name)) for name in ("threshold", "precision", "recall", "f1")}
    working = {metric: own.get(metric) for metric in ("precision", "recall", "f1")}
    return {"name": f"{curve.class_}, {space}", "working": working, **lines}
