"""Output of `fbench log info`."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from fbench.cli.show import console, fault_lines, print_json
from fbench.replay.check.survey import Stream, Survey, survey
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.data.metadata import REGIONS
from fbench.replay.data.rig import CameraModel, LogInfo, Mount
from fbench.replay.logs.open import Storage
from fbench.replay.setup.source import LogSource

_MAX_VALUE = 300  # Of metadata on the terminal


def show_info(log: LogSource, as_json: bool) -> int:
    """Print what a log holds; returns the exit code."""
    faults = FaultLog()
    with explain_losses(faults):
        result = survey(log.open(faults), log.sync(None, None, None, None))
    if as_json:
        print_json(_content(result, faults))
    else:
        _print(log.path, result, faults)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _content(result: Survey, faults: FaultLog) -> dict[str, object]:
    breaks = result.breaks
    return {
        "name": result.info.name,
        "log_id": result.info.log_id,
        "metadata": dict(sorted(result.info.metadata.items())),
        "storage": asdict(result.storage),
        "first_log_ns": None if result.span_ns is None else result.span_ns[0],
        "last_log_ns": None if result.span_ns is None else result.span_ns[1],
        "reference": result.reference,
        "streams": [asdict(s) for s in result.streams],
        "topics": [asdict(t) for t in result.topics],
        "mounts": {name: _mount(m) for name, m in sorted(result.known.rig.mounts.items())},
        "cameras": {name: _camera(c) for name, c in sorted(result.known.rig.cameras.items())},
        "uncalibrated": dict(sorted(result.known.problems.items())),
        "truth": result.num_truths,
        "frames": result.num_frames,
        "segments": None if breaks is None else len(breaks) + 1,
        "breaks": None if breaks is None else list(breaks),
        "verified": False,
        "faults": faults.rows(),
    }


def _mount(m: Mount) -> dict[str, object]:
    return {"kind": m.kind, "translation_m": m.translation_m.tolist(), "rotation_xyzw": m.rotation_xyzw.tolist()}


def _camera(c: CameraModel) -> dict[str, object]:
    return {
        "size_wh": c.size_wh, "K": c.K.tolist(), "distortion_model": c.distortion_model,
        "distortion": c.distortion.tolist(),
    }  # fmt: skip


def _print(log: Path, result: Survey, faults: FaultLog) -> None:
    out = console()

    def say(line: str) -> None:
        out.print(line, markup=False, soft_wrap=True)

    say(f"{log}: {_summary(result)}")
    say(f"id: {result.info.log_id}")
    say(f"stored: {_form(result.storage)}")
    out.print(_streams(result))
    out.print(_topics(result))
    for line in _notes(result, faults):
        say(line)


def _summary(result: Survey) -> str:
    first, last = result.span_ns or (0, 0)
    frames = f"{result.num_frames} frames by {result.reference}" if result.reference else "no frames"
    truths = f"{result.num_truths} messages of truth" if result.num_truths else "no truth"
    return f"{(last - first) / 1e9:.1f} s, {frames}, {_segments(result.breaks)}, {truths}"


def _segments(breaks: tuple[str, ...] | None) -> str:
    if breaks is None:
        return "segments unknown without reading"
    return "1 segment" if not breaks else f"{len(breaks) + 1} segments by log time"


def _form(form: Storage) -> str:
    parts = [form.form, *(["compression " + ", ".join(form.compression)] if form.compression else [])]
    parts += [] if form.num_blocks is None else [f"{form.num_blocks} chunks"]
    return ", ".join([*parts, f"{form.num_bytes / 1e6:.1f} MB", "indexed" if form.is_indexed else "no index"])


def _notes(result: Survey, faults: FaultLog) -> Iterator[str]:
    metadata = sorted(result.info.metadata.items())
    yield from (f"{key}: {_short(value)}" for key, value in metadata if key != REGIONS)
    yield from _regions(result.info)
    yield from (f"no calibration: {why}" for why in dict.fromkeys(result.known.problems.values()))
    yield from (f"new segment by log time: {why}" for why in result.breaks or ())
    yield from fault_lines(faults.rows())
    yield "not verified; see fbench log check"


def _regions(info: LogInfo) -> Iterator[str]:
    if REGIONS in info.metadata:
        kinds = Counter(region.kind for region in info.regions)
        yield f"{REGIONS}: {', '.join(f'{num} of kind {kind}' for kind, num in sorted(kinds.items())) or 'none'}"


def _short(value: str) -> str:
    """A list of tokens, say, is for programs."""
    return value if len(value) <= _MAX_VALUE else f"{value[:_MAX_VALUE]}… ({len(value)} characters, all with --json)"


def _streams(result: Survey) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("sensor", "kind", "messages", "Hz", "x, y, z on the body [m]", "camera"):
        table.add_column(column)
    for s in result.streams:
        table.add_row(s.sensor, s.kind, str(s.num_messages), _rate(s), _position(result, s.sensor), _lens(result, s))
    return table


def _rate(s: Stream) -> str:
    return "–" if s.rate_hz is None else f"{s.rate_hz:.1f}"


def _position(result: Survey, sensor: str) -> str:
    mount = result.known.rig.mounts.get(sensor)
    if mount is None:
        return "no calibration" if sensor in result.known.problems else ""
    return ", ".join(f"{v:z.2f}" for v in mount.translation_m)


def _lens(result: Survey, s: Stream) -> str:
    camera = result.known.rig.cameras.get(s.sensor)
    if camera is None:
        return "no calibration" if s.kind == "camera" else ""
    return f"{camera.size_wh[0]}x{camera.size_wh[1]}, f {camera.K[0, 0]:.0f} px"


def _topics(result: Survey) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("topic", "schema", "messages", "use"):
        table.add_column(column, overflow="fold")
    for t in result.topics:
        table.add_row(t.topic, t.schema or t.encoding, str(t.num_messages), t.kind or "none")
    return table
