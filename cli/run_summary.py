"""Summary of a finished run: scores, latency, what was missing, faults."""

import json
import sys
from collections import Counter
from typing import Any

import numpy as np

from fbench.cli.show import console, fault_lines, latency_table, print_json, say, score_notes, score_table
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK
from fbench.replay.runs.folder import Run
from fbench.replay.runs.shares import coverage_of, predictions_of


def show_run(run: Run, as_json: bool) -> None:
    """Print scores, latency, faults, and where the run is."""
    if as_json:
        names = ("scores.json", "latency.json", "faults.json")
        content = {name.removesuffix(".json"): run.json(name) for name in names}
        manifest = json.loads(run.manifest.model_dump_json())
        print_json({"run": str(run.folder), "manifest": manifest, **content})
        return
    out = console()
    out.print(score_table(run.scores))
    say(*score_notes(run.scores), "")
    _show_latency(run.json("latency.json"))
    say("", *_status(run))


def _show_latency(latency: dict[str, Any]) -> None:
    if not any(stage["count"] or stage["first_ms"] is not None for stage in latency["stages"]):
        say("latency: nothing was timed")
        return
    console().print(latency_table(latency))
    if latency.get("clock") == "log":
        say("latency is from times of recording in the log, not measured here")
    over, num, budget_ms = latency["over_budget"], latency["frames"], latency["budget_ms"]
    over_budget = f"{over} of {num} {_plural('frame', num)} over the budget of {budget_ms:g} ms"
    say(over_budget if num else "the first frame isn't counted, and there is no other")


def _status(run: Run) -> list[str]:
    manifest = run.manifest
    segments = "1 segment" if manifest.num_segments == 1 else f"{manifest.num_segments} segments"
    lines = [f"frames: {manifest.num_frames} in {segments}", f"truth: {coverage_of(run)}"]
    if all((run.folder / f"{name}.parquet").is_file() for name in ("detections", "tracks")):
        # Scores don't say how much came out where there is no truth.
        detections, tracks = len(run.detections.boxes), run.tracks.boxes
        num_ids = 0 if tracks.track_id is None else len(np.unique(tracks.track_id))
        lines.append(f"found: {detections} {_plural('detection', detections)}, {num_ids} {_plural('track', num_ids)}")
    predictions = predictions_of(run)
    lines += [] if predictions is None else [f"predicted: {predictions}"]
    missing = Counter(f"{sensor} ({_kind(reason)})" for frame in run.frames for sensor, reason in frame.missing.items())
    lines += [f"missing: {what} in {num} {_plural('frame', num)}" for what, num in sorted(missing.items())]
    counts = run.json("faults.json")
    for sensor, num in counts["late_messages"].items():
        late = f"late: {num} {_plural('message', num)} of {sensor} came after"
        lines += [f"{late} {'its' if num == 1 else 'their'} frame was released"] if num else []
    for sensor, num in counts["unused_messages"].items():
        # Poses between frames are used, to find those at the frames' instants.
        is_sensor = sensor in manifest.mounts
        unused = f"unused: {num} {_plural('message', num)} of {sensor}, which frames don't need"
        lines += [unused] if num and is_sensor else []
    lines += fault_lines(counts["rows"])
    if not manifest.complete:
        lines.append("INCOMPLETE: data was lost, so these numbers aren't those of the whole log")
    report = run.folder / "report.html"
    lines.append(_pace(run.json("host.json")))
    return [*lines, f"run: {run.folder}", *([f"report: {report}"] if report.is_file() else [])]


def _pace(host: dict[str, Any]) -> str:
    achieved = f"{host['achieved_rate']:.3g}x" if "achieved_rate" in host else "–"
    if host["rate"] == "max":
        return f"pace: {achieved} real time"
    return (
        f"pace: asked {host['rate']}x, achieved {achieved}, "
        f"p99 late {host['p99_late_ms']:.1f} ms, max {host['max_late_ms']:.1f} ms"
    )


def _plural(noun: str, num: int) -> str:
    return noun if num == 1 else f"{noun}s"


def _kind(reason: str) -> str:
    """A reason without its number: 'late by 12.3 ms' is 'late'."""
    return "late" if reason.startswith("late by") else reason


def require_coverage(run: Run, min_coverage: float, code: int) -> int:
    """Return the exit code of a command that ends with `code`: 1 if all else is good, but too few outputs had truth.

    A line on stderr says so then.
    """
    coverage = coverage_of(run)
    if coverage.share >= min_coverage:
        return code
    sys.stderr.write(f"too little truth: {coverage}, fewer than --min-coverage {min_coverage:g} asks for\n")
    return EXIT_NO if code == EXIT_OK else code
