"""What `fbench log info` prints."""

import json
from dataclasses import asdict
from pathlib import Path

from rich.table import Table

from fbench.replay.cli.job import explained
from fbench.replay.cli.show import console
from fbench.replay.data import CameraModel, Mount
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.faults import FaultLog
from fbench.replay.logs.open import open_log
from fbench.replay.survey import Stream, Survey, survey
from fbench.replay.sync import SyncParams


def show_info(log: Path, as_json: bool) -> int:
    """Print what a log holds; returns the exit code."""
    faults = FaultLog()
    with explained(faults):
        result = survey(open_log(log, faults), SyncParams())
    if as_json:
        print(json.dumps(_content(result, faults), indent=1, allow_nan=False))  # noqa: T201
    else:
        _print(log, result, faults)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _content(result: Survey, faults: FaultLog) -> dict[str, object]:
    return {
        "name": result.info.name,
        "log_id": result.info.log_id,
        "metadata": dict(result.info.metadata),
        "reference": result.reference,
        "streams": [{**asdict(s), "rate_hz": s.rate_hz} for s in result.streams],
        "mounts": {name: _mount(m) for name, m in sorted(result.rig.mounts.items())},
        "cameras": {name: _camera(c) for name, c in sorted(result.rig.cameras.items())},
        "truth": result.num_truths,
        "frames": result.num_frames,
        "segments": len(result.breaks) + 1,
        "breaks": list(result.breaks),
        "faults": faults.rows(),
    }


def _mount(m: Mount) -> dict[str, object]:
    return {"kind": m.kind, "translation_m": m.translation_m.tolist(), "rotation_xyzw": m.rotation_xyzw.tolist()}


def _camera(c: CameraModel) -> dict[str, object]:
    return {"size_wh": c.size_wh, "K": c.K.tolist(), "distortion_model": c.distortion_model}


def _print(log: Path, result: Survey, faults: FaultLog) -> None:
    out = console()
    out.print(f"{log}: {_duration_s(result.streams):.1f} s, {result.num_frames} frames by {result.reference}, "
              f"{len(result.breaks) + 1} segments, truth for {result.num_truths}", markup=False)  # fmt: skip
    out.print(f"id: {result.info.log_id}", markup=False, soft_wrap=True)
    out.print(_streams(result))
    for line in [f"{key}: {value}" for key, value in sorted(result.info.metadata.items())]:
        out.print(line, markup=False, soft_wrap=True)
    for line in [f"new segment: {why}" for why in result.breaks]:
        out.print(line, markup=False, soft_wrap=True)
    for row in faults.rows():
        if row["count"]:
            out.print(
                f"fault: {row['code']} {row['text']}: {row['count']} {row['places']}", markup=False, soft_wrap=True
            )


def _duration_s(streams: tuple[Stream, ...]) -> float:
    first, last = (s.first_stamp_ns for s in streams), (s.last_stamp_ns for s in streams)
    return (max(last, default=0) - min(first, default=0)) / 1e9


def _streams(result: Survey) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in ("sensor", "kind", "messages", "Hz", "x, y, z on the body [m]", "camera"):
        table.add_column(column)
    for s in result.streams:
        mount, camera = result.rig.mounts.get(s.sensor), result.rig.cameras.get(s.sensor)
        position = "" if mount is None else ", ".join(f"{v:.2f}" for v in mount.translation_m)
        size = "" if camera is None else f"{camera.size_wh[0]}x{camera.size_wh[1]}, f {camera.K[0, 0]:.0f} px"
        rate = "–" if s.rate_hz is None else f"{s.rate_hz:.1f}"
        table.add_row(s.sensor, s.kind, str(s.num_messages), rate, position, size)
    return table
