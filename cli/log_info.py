"""`fbench log info`."""

import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from fbench.cli import options
from fbench.cli.show import console, fault_lines, make_table, print_json, say
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.data.scores import format_count

if TYPE_CHECKING:
    from fbench.replay.check.survey import Survey
    from fbench.replay.contracts.faults import FaultLog

_MAX_VALUE = 300  # Of metadata on the terminal


def info(
    log: options.Log,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    json: options.Json = False,
) -> None:
    """Show what a log holds: topics, rates, duration, sensors, calibration, truth, segments."""
    from fbench.replay.check.survey import survey
    from fbench.replay.contracts.faults import FaultLog, explain_losses
    from fbench.replay.setup.source import LogRequest, log_source

    faults = FaultLog()
    with redirect_stdout(sys.stderr), explain_losses(faults):  # what a decoder prints is no line of --json
        source = log_source(LogRequest(log, config, rig or (), decoder=decoder or ()))
        result = survey(source.open(faults), source.sync_params(None, None, None, None))
    if json:
        print_json(_content(result, faults))
    else:
        _print(log, result)
        say(*_notes(result, faults))
    raise typer.Exit(EXIT_LOSSY if faults.num_lost else EXIT_OK)


def _content(result: "Survey", faults: "FaultLog") -> dict[str, object]:
    first, last = result.span_ns or (None, None)
    breaks, rig = result.breaks, result.known.rig
    return {
        "name": result.info.name,
        "log_id": result.info.log_id,
        "metadata": dict(sorted(result.info.metadata.items())),
        "storage": asdict(result.storage),
        "first_log_ns": first,
        "last_log_ns": last,
        "reference": result.reference,
        "streams": [asdict(s) for s in result.streams],
        "topics": [asdict(t) for t in result.topics],
        "mounts": {
            name: {"kind": m.kind, "translation_m": m.translation_m.tolist(), "rotation_xyzw": m.rotation_xyzw.tolist()}
            for name, m in sorted(rig.mounts.items())
        },
        "cameras": {
            name: {
                "size_wh": c.size_wh,
                "K": c.K.tolist(),
                "distortion_model": c.distortion_model,
                "distortion": c.distortion.tolist(),
            }
            for name, c in sorted(rig.cameras.items())
        },
        "rig_changes": None
        if result.rig_changes is None
        else [{"log_ns": change.log_ns, "sensors": list(change.sensors)} for change in result.rig_changes],
        "uncalibrated": dict(sorted(result.known.problems.items())),
        "truth": result.num_truths,
        "frames": result.num_frames,
        "segments": None if breaks is None else len(breaks) + 1,
        "breaks": None if breaks is None else list(breaks),
        "verified": False,
        "faults": faults.rows(),
    }


def _print(log: Path, result: "Survey") -> None:
    (first, last), form = result.span_ns or (0, 0), result.storage
    is_estimate = any(s.is_estimate for s in result.streams if s.sensor == result.reference)
    num_frames = format_count(result.num_frames, "frame", is_estimate=is_estimate)
    frames = f"{num_frames} by {result.reference}" if result.reference else "no frames"
    truths = f"{format_count(result.num_truths, 'message')} of truth" if result.num_truths else "no truth"
    segments = "segments unknown without reading"
    if result.breaks is not None:
        segments = format_count(len(result.breaks) + 1, "segment") + (" by log time" if result.breaks else "")
    rigs = f", {len(result.rig_changes) + 1} rigs" if result.rig_changes else ""
    say(f"{log}: {(last - first) / 1e9:.1f} s, {frames}, {segments}{rigs}, {truths}", f"id: {result.info.log_id}")
    parts = [form.form, *(["compression " + ", ".join(form.compression)] if form.compression else [])]
    parts += [] if form.num_blocks is None else [format_count(form.num_blocks, "chunk")]
    parts += [f"{form.num_bytes / 1e6:.1f} MB", "indexed" if form.is_indexed else "no index"]
    say(f"stored: {', '.join(parts)}")
    rig, problems = result.known.rig, result.known.problems
    table = make_table("sensor", "kind", "messages", "Hz", "x, y, z on the body [m]", "camera")
    for s in result.streams:
        rate = "–" if s.rate_hz is None else f"{s.rate_hz:.1f}"
        mount, camera = rig.mounts.get(s.sensor), rig.cameras.get(s.sensor)
        position = "no calibration" if s.sensor in problems else ""
        if mount is not None:
            position = ", ".join(f"{v:z.2f}" for v in mount.translation_m)
        lens = "no calibration" if s.kind == "camera" else ""
        if camera is not None:
            lens = f"{camera.size_wh[0]}x{camera.size_wh[1]}, f {camera.K[0, 0]:.0f} px"
        num = f"{'≈' if s.is_estimate else ''}{s.num_messages}"
        table.add_row(s.sensor, s.kind, num, rate, position, lens)
    console().print(table)
    topics = make_table("topic", "schema", "messages", "use")
    for column in topics.columns:
        column.overflow = "fold"
    for t in result.topics:
        topics.add_row(t.topic, t.schema or t.encoding, str(t.num_messages), t.kind or "none")
    console().print(topics)


def _notes(result: "Survey", faults: "FaultLog") -> Iterator[str]:
    from fbench.replay.data.metadata import REGIONS

    metadata = sorted(result.info.metadata.items())
    for key, value in metadata:
        if key != REGIONS:  # a list of tokens, say, is for programs
            rest = f"… ({len(value)} characters, all with --json)" if len(value) > _MAX_VALUE else ""
            yield f"{key}: {value[:_MAX_VALUE]}{rest}"
    if REGIONS in result.info.metadata:
        kinds = Counter(region.kind for region in result.info.regions)
        yield f"{REGIONS}: {', '.join(f'{num} of kind {kind}' for kind, num in sorted(kinds.items())) or 'none'}"
    yield from (f"no calibration: {why}" for why in dict.fromkeys(result.known.problems.values()))
    if result.rig_changes is None:
        yield "rigs: whether the calibration changes isn't known without reading"
    yield from (f"new segment by log time: {why}" for why in result.breaks or ())
    yield from fault_lines(faults.rows())
    yield "not verified; see fbench log check"
