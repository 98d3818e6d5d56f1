"""The kept frames of all runs: pictures, points and boxes, for the script that draws them."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fbench.replay.data import Boxes, Kind, Rig
from fbench.replay.media import MediaFrame, Points
from fbench.replay.store import Run
from fbench.reports.html.boxes import box_rows
from fbench.reports.html.timeline import row_numbers, timeline

MAX_POINTS = 4000
"""Of one cloud; more can't be told apart at the size of the view."""
MAX_BARE = 40
"""Frames that are shown by their boxes alone."""
_CM = 100.0
_NO_SPEED = -32768


@dataclass
class _Pool:
    """Contents that several runs share, such as images of one log, are stored once."""

    numbers: dict[str, int] = field(default_factory=dict)

    def add(self, content: bytes) -> int:
        text = base64.b64encode(content).decode("ascii")
        return self.numbers.setdefault(text, len(self.numbers))


def scenes(runs: Sequence[Run], labels: Sequence[str]) -> dict[str, Any]:
    """Return timelines and kept frames of all runs.

    Pictures are JPEG and clouds little-endian int16 (x, y, z [cm] in body coordinates, radial velocity [cm/s]), both
    in base64, in pools that the frames refer to by number.
    """
    pictures, clouds = _Pool(), _Pool()
    content = [_run(run, label, pictures, clouds) for run, label in zip(runs, labels, strict=True)]
    return {"runs": content, "pictures": list(pictures.numbers), "clouds": list(clouds.numbers)}


def shown_frames(run: Run) -> tuple[MediaFrame, ...]:
    """The frames that a run kept; where it kept none, as of a log without measurements, some with boxes."""
    if run.media or not run.frames:
        return run.media
    boxes = np.concatenate([run.tracks.frames, run.detections.frames]).astype(np.int64)
    found = {int(index) for index in np.unique(boxes)}
    some = [f.index for f in run.frames if f.index in found or f.truth_stamp_ns is not None]
    return tuple(MediaFrame(index) for index in some[:: max(1, -(-len(some) // MAX_BARE))])


def _run(run: Run, label: str, pictures: _Pool, clouds: _Pool) -> dict[str, Any]:
    rig, rows = run.manifest.rig, row_numbers(run)
    return {
        "label": label,
        "timeline": timeline(run),
        "cameras": {name: list(camera.size_wh) for name, camera in sorted(rig.cameras.items())},
        "frames": [
            {"index": rows[kept.index], **_frame(run, rig, kept, pictures, clouds)}
            for kept in shown_frames(run)
            if kept.index in rows
        ],
    }


def _frame(run: Run, rig: Rig, kept: MediaFrame, pictures: _Pool, clouds: _Pool) -> dict[str, Any]:
    cameras = [name for name in sorted(kept.pictures) if name in rig.cameras and name in rig.mounts]
    truth: Boxes | None = run.truth3d(kept.index)
    truth = run.truth2d(kept.index) if truth is None else truth
    return {
        "pictures": {name: pictures.add(picture.jpeg) for name, picture in sorted(kept.pictures.items())},
        "clouds": [_cloud(rig, name, points, clouds) for name, points in sorted(kept.points.items())],
        "labelled": truth is not None,
        "truth": box_rows(truth, rig, cameras),
        "detections": box_rows(run.detections.at(kept.index), rig, cameras),
        "tracks": box_rows(run.tracks.at(kept.index), rig, cameras),
    }


def _cloud(rig: Rig, name: str, points: Points, clouds: _Pool) -> dict[str, Any]:
    kind: Kind = rig.mounts[name].kind if name in rig.mounts else "lidar"
    return {"sensor": name, "kind": kind, "cloud": clouds.add(_packed(points))}


def _packed(points: Points) -> bytes:
    """Rows x, y, z, radial velocity in hundredths; -32768 where there is no velocity."""
    num = len(points.xyz)
    rows = np.arange(min(num, MAX_POINTS)) * num // max(1, min(num, MAX_POINTS))
    table = np.concatenate([points.xyz[rows], points.speed_mps[rows, None]], axis=1).astype(np.float64)
    whole = np.clip(np.round(table * _CM), -32767, 32767)
    return np.where(np.isfinite(table), whole, _NO_SPEED).astype("<i2").tobytes()
