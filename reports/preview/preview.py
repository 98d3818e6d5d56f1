"""Puts a preview together: pictures, verdicts, and the sheet that shows them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from fbench.replay.data import KINDS, Rig
from fbench.replay.geometry.stereo_pairs import pairs
from fbench.replay.geometry.transforms import yaw_pitch_roll
from fbench.reports.preview.album import Album
from fbench.reports.preview.content import Content, FrameContent, SensorRow
from fbench.reports.preview.frame_pictures import FramePictures
from fbench.reports.preview.measure import Measured
from fbench.reports.preview.sample import Material, Sample
from fbench.reports.preview.sheet import sheet
from fbench.reports.preview.times import SensorTimes, sensor_times
from fbench.reports.preview.views import ground_of

SHEET = "index.html"


def write_preview(material: Material, folder: Path) -> Content:
    """Write `index.html` and the pictures that it shows into an existing folder; equal bytes for equal material."""
    names = sorted({*material.kinds, *material.num_messages})
    album = Album(folder, names)
    times = sensor_times(material)
    measured = Measured(material, album, gaps=list(_gaps(material)))
    measured.times(times)
    measured.mounting()
    measured.doppler()
    measured.labels()
    measured.alignment()
    stereo = measured.stereo()
    draw = FramePictures(album, ground_of(material.samples), [n for n in names if material.kinds.get(n) == "lidar"])
    frames = [
        FrameContent(s.frame.index, _head(s), [*draw.of(s), *stereo.get(s.frame.index, [])]) for s in material.samples
    ]
    rows = [_row(material, t) for t in times]
    verdicts = sorted(measured.verdicts, key=lambda v: not v.is_bad)
    content = Content(material.info.name, _facts(material), rows, verdicts, measured.gaps, measured.shown, frames)
    (folder / SHEET).write_text(sheet(content), "utf-8")
    return content


def _gaps(material: Material) -> Sequence[str]:
    """Say what isn't there."""
    names = {"camera": "camera", "lidar": "LiDAR", "radar": "radar"}
    gaps = [f"the log has no {names[kind]}" for kind in KINDS if kind not in material.kinds.values()]
    gaps += [f"{why}: it is shown on its own" for _, why in sorted(material.problems.items())]
    gaps += [] if material.num_labelled else ["no frame has truth"]
    if sum(kind == "camera" for kind in material.kinds.values()) > 1 and not pairs(material.rig):
        gaps.append("no two cameras are a stereo pair (one size, parallel within 10 deg, 0.05 to 2 m side by side)")
    world = [s for s in material.samples if s.truth is not None and s.truth.in_world and s.truth.boxes3d is not None]
    return [*gaps, *(["3D truth is in world coordinates and isn't drawn"] if world else [])]


def _facts(material: Material) -> Sequence[tuple[str, str]]:
    shown = f"{len(material.samples)} of {material.num_frames}"
    labelled = f"{material.num_labelled} of {material.num_frames}"
    return [
        ("Frames shown", shown), ("Instants by", material.reference), ("With truth", labelled),
        ("Log id", material.info.log_id),
    ]  # fmt: skip


def _head(sample: Sample) -> str:
    missing = "; ".join(f"{name}: {why}" for name, why in sorted(sample.frame.missing.items()))
    return f"at {sample.frame.stamp_ns} ns{f' · missing: {missing}' if missing else ''}"


def _row(material: Material, times: SensorTimes) -> SensorRow:
    name = times.sensor
    missing = f"{times.num_missing} of {material.num_frames}: {times.reasons}" if times.num_missing else "0"
    return SensorRow(
        name, material.kinds.get(name, "pose"), times.num_messages, missing, _mounted(material.rig, name),
        _camera(material.rig, name), _spread(times.shift_ms), _spread(times.delay_ms), material.problems.get(name, ""),
    )  # fmt: skip


def _mounted(rig: Rig, name: str) -> str:
    if name not in rig.mounts:
        return ""
    mount = rig.mounts[name]
    angles = ", ".join(f"{np.degrees(a) + 0.0:.2f}" for a in yaw_pitch_roll(mount.rotation_xyzw))
    place = ", ".join(f"{value + 0.0:.3f}" for value in mount.translation_m)
    return f"{place} m; yaw, pitch, roll {angles}°"


def _camera(rig: Rig, name: str) -> str:
    if name not in rig.cameras:
        return ""
    camera = rig.cameras[name]
    width, height = camera.size_wh
    lens = camera.distortion_model if np.any(camera.distortion) else "no distortion"
    return f"{width} × {height} px, f {camera.K[0, 0]:.0f} px, {lens}"


def _spread(values: tuple[float, float, float] | None) -> str:
    if values is None:
        return "–"
    middle, low, high = values
    return f"{middle:+.1f} ({low:+.1f} to {high:+.1f})"
