"""Summary of a finished run: scores, latency, what was missing, faults."""

import json
import re
import sys
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from fbench.cli.show import console, fault_lines, latency_table, make_table, print_json, say, score_notes, score_table
from fbench.replay.conditions.effects import describe
from fbench.replay.contracts.errors import EXIT_NO, EXIT_OK
from fbench.replay.contracts.faults import UNVERIFIED
from fbench.replay.data.criticality import FILE, load_critical_errors
from fbench.replay.data.scores import DASH, FORECAST, LOCKSTEP, STREAMING, format_count
from fbench.replay.runs.folder import Run
from fbench.replay.runs.shares import coverage_of, predictions_of
from fbench.replay.runs.timings import WAIT

_CRITICAL = ("critical_misses", "critical_false_alarms")
_WORST = 3
_STREAMED = ("f1", "ap", "mota", "hota")
_SLICES = (LOCKSTEP, STREAMING, FORECAST)
_AMOUNT = re.compile(r" by [\d.]+ ms$")


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
    say(*score_notes(run.scores), *_describe_critical(run), "")
    if run.manifest.latency is not None:
        _show_streaming(run)
    _show_latency(run.json("latency.json"))
    say("", *_status(run))


def _describe_critical(run: Run) -> list[str]:
    """Say how many errors are critical, of tracks where there are any, and which are the worst."""
    errors, side = load_critical_errors(run.folder), "tracks" if run.manifest.has_tracks else "detections"
    names = ("critical_untracked", "critical_false_tracks") if run.manifest.has_tracks else _CRITICAL
    rows = {row.metric: row for row in run.scores if row.class_ == "vehicle" and row.slice == "all"}
    missed, false = (rows.get(name) for name in names)
    if errors is None or missed is None or false is None:
        return []
    if missed.value is None:
        return [f"critical errors of {side}: unknown, {missed.reason}"]
    own = sorted((e for e in errors if e.side == side), key=lambda e: (e.ttc_s, -e.deceleration_mps2))
    counts = Counter(error.kind for error in own)
    parts = [format_count(counts["miss"], "miss", "misses"), format_count(counts["false alarm"], "false alarm")]
    more = [f"  {error}" for error in own[:_WORST]]
    more += [f"  {len(own) - _WORST} more, see {FILE}"] if len(own) > _WORST else []
    return [f"critical errors of {side}: {', '.join(parts)}", *more]


def _show_streaming(run: Run) -> None:
    """Print what is left of the scores in lockstep when outputs count from when they are ready."""
    rows = {row.key: row for row in run.scores}
    kept = [row for row in run.scores if row.slice == LOCKSTEP and row.metric in _STREAMED]
    several = len({row.matching for row in kept if row.value is not None}) > 1
    table = make_table("latency", *_SLICES, "price", right=(*_SLICES, "price"))
    for row in kept:
        values = [rows[row.metric, row.class_, name, row.matching].value for name in _SLICES]
        lockstep, streaming, _ = values
        if lockstep is None and streaming is None:
            continue
        price = DASH if lockstep is None or streaming is None else f"{lockstep - streaming:.3f}"
        name = f"{row.metric}, {row.matching.partition(',')[0]}" if several else row.metric
        table.add_row(name, *(DASH if value is None else f"{value:.3f}" for value in values), price)
    if table.row_count:
        console().print(table)
    age = next(row for row in run.scores if row.metric == "staleness")
    num = age.counts["without_output"]
    lines = [f"outputs are {age.value:.1f} ms old on average" if age.value is not None else str(age.reason)]
    lines += [f"{format_count(int(num), 'frame')} before the first output, in which nothing is found"] if num else []
    say(*lines, "")


def _show_latency(latency: dict[str, Any]) -> None:
    if not any(stage["count"] or stage["first_ms"] is not None for stage in latency["stages"]):
        say("latency: nothing was timed")
        return
    console().print(latency_table(latency))
    if latency.get("clock") == "log":
        say("latency is from times of recording in the log, not measured here")
    over, num, budget_ms = latency["over_budget"], latency["frames"], latency["budget_ms"]
    over_budget = f"{over} of {format_count(num, 'frame')} over the budget of {budget_ms:g} ms"
    say(over_budget if num else "no frame is left that warmed nothing up, so there is no latency")
    outside = {row["stage"]: row for row in latency.get("outside", ()) if row["p50_ms"] is not None and row["max_ms"]}
    if waits := outside.get(WAIT):
        say(
            f"frames waited {waits['p50_ms']:.2f} ms for their sensors (median), at most {waits['max_ms']:.2f} ms, "
            "in log time"
        )
    if latency["warm_up_frames"]:
        compiled = (
            f" (in {latency['compiled_frames']} code was compiled or loaded)" if latency["compiled_frames"] else ""
        )
        say(f"{format_count(latency['warm_up_frames'], 'frame')} of warm-up left out{compiled}")


def _status(run: Run) -> list[str]:
    manifest = run.manifest
    segments = format_count(manifest.num_segments, "segment")
    lines = [f"frames: {manifest.num_frames} in {segments}", f"truth: {coverage_of(run)}"]
    if (latency := manifest.latency) is not None:
        lines.append(f"dropped: {format_count(latency.num_dropped, 'frame')} (latency {latency})")
    if all((run.folder / f"{name}.parquet").is_file() for name in ("detections", "tracks")):
        # Scores don't say how much came out where there is no truth.
        detections, tracks = len(run.detections.boxes), run.tracks.boxes
        num_ids = 0 if tracks.track_id is None else len(np.unique(tracks.track_id))
        lines.append(f"found: {format_count(detections, 'detection')}, {format_count(num_ids, 'track')}")
    predictions = predictions_of(run)
    lines += [] if predictions is None else [f"predicted: {predictions}"]
    # Without numbers: 'late by 12.3 ms' is 'late', 'off by 60.0 ms' is 'off'.
    reasons = ((sensor, why) for frame in run.frames for sensor, why in frame.missing.items())
    missing = Counter(f"{sensor} ({_AMOUNT.sub('', why)})" for sensor, why in reasons)
    lines += [f"missing: {what} in {format_count(num, 'frame')}" for what, num in sorted(missing.items())]
    if manifest.conditions:
        lines.append(f"conditions: {', '.join(map(str, manifest.conditions))}; seed {manifest.seed}")
    lines += [f"changed: {sensor}: {describe(row)}" for sensor, row in manifest.effects.items()]
    counts = run.json("faults.json")
    for sensor, num in counts["late_messages"].items():
        late = f"late: {format_count(num, 'message')} of {sensor} came after"
        lines += [f"{late} {'its' if num == 1 else 'their'} frame was released"] if num else []
    for sensor, num in counts["unused_messages"].items():
        if num and sensor in manifest.mounts:  # poses between frames are used, to find those at the frames' instants
            lines.append(f"unused: {format_count(num, 'message')} of {sensor}, which frames don't need")
    lines += fault_lines(counts["rows"])
    if any(row["code"] == UNVERIFIED and row["count"] for row in counts["rows"]):
        lines.append("integrity: unknown, as the log has no checksums; fbench log convert writes one with them")
    if not manifest.complete:
        lines.append("INCOMPLETE: data was lost, so these numbers aren't those of the whole log")
    report, host = run.folder / "report.html", run.json("host.json")
    achieved = f"{host['achieved_rate']:.3g}x" if "achieved_rate" in host else "–"
    if host["rate"] == "max":
        speed = f", {host['frames_per_s']:.3g} frames/s" if host.get("frames_per_s") else ""
        overlap = f", in {host['overlap']} processes" if host.get("overlap", 1) > 1 else ""
        lines.append(f"pace: {achieved} real time{speed}{overlap}")
    else:
        late = f"p99 late {host['p99_late_ms']:.1f} ms, max {host['max_late_ms']:.1f} ms"
        late += f", drift {host['drift_ms_per_min']:.2f} ms a minute" if "drift_ms_per_min" in host else ""
        lines.append(f"pace: asked {host['rate']}x, achieved {achieved}, {late}")
    lines += _describe_device(run, host)
    return [*lines, f"run: {run.folder}", *([f"report: {report}"] if report.is_file() else [])]


def _describe_device(run: Run, host: Mapping[str, object]) -> list[str]:
    if host.get("device", "cpu") == "cpu":
        return []
    is_used = run.manifest.execution.device != "cpu"
    return [f"device: {run.manifest.execution if is_used else 'cpu, as the pipeline runs no network of its own'}"]


def require_coverage(run: Run, min_coverage: float, code: int) -> int:
    """Return the exit code of a command that ends with `code`: 1 if all else is good, but too few outputs had truth. A
    line on stderr says so then.
    """
    coverage = coverage_of(run)
    if coverage.share >= min_coverage:
        return code
    sys.stderr.write(f"too little truth: {coverage}, but --min-coverage requires {min_coverage:g}\n")
    return EXIT_NO if code == EXIT_OK else code
