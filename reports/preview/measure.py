"""Pictures and verdicts about a whole log."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Bool, Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.geometry.stereo_pairs import Pair, Rectified, pairs, rectified
from fbench.reports.preview.alignment import aligned, edges_of, edges_view
from fbench.reports.preview.content import Album, Shown, Verdict
from fbench.reports.preview.doppler import doppler_panel
from fbench.reports.preview.doppler import judged as judged_of_doppler
from fbench.reports.preview.sample import Material, Sample
from fbench.reports.preview.stereo import StereoView, stereo_view
from fbench.reports.preview.times import SensorTimes, time_panel
from fbench.reports.preview.views import mounting

_NEAR_M, _FAR_M = 25.0, 150.0
"""Nearer boxes should hold points, unless they are hidden; nobody labels what is farther away."""
_MIDDLE, _WIDER_M = 0.3, 0.5
"""Points count in this share of a box's height above and below its middle, so that the ground doesn't, and that far
beside it, since the vehicle moves during a sweep."""
_SIDE_RAD = 0.1
_FEW, _MIN_SHARE = 5, 0.5


@dataclass(frozen=True)
class Labels:
    """What is found."""

    text: str
    is_bad: bool


def judged(samples: Sequence[Sample]) -> Labels | None:
    """Count the boxes that hold points, among those near the body in whose direction a LiDAR sees something."""
    pairs = [(_labelled(s), _points(s)) for s in samples]
    away = [np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1]) for boxes, _ in pairs if len(boxes)]
    if away and (nearest := float(np.min(np.concatenate(away)))) > _FAR_M:
        num = sum(len(part) for part in away)
        text = f"the nearest of {num} boxes is {nearest:.0f} m away: wrong coordinate frame, or poses of another one?"
        return Labels(text, True)
    hit = np.concatenate([np.zeros(0, np.bool_), *(_hits(boxes, xyz) for boxes, xyz in pairs)])
    if len(hit) < _FEW:
        return None
    text = f"{int(hit.sum())} of {len(hit)} boxes within {_NEAR_M:g} m hold LiDAR points above the ground"
    is_bad = bool(hit.mean() <= _MIN_SHARE)
    return Labels(text + (": wrong coordinate frame, stamps or sizes?" if is_bad else ""), is_bad)


def _labelled(sample: Sample) -> Boxes3D:
    truth = sample.truth
    if truth is None or truth.boxes3d is None or truth.in_world:
        return Boxes3D(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    boxes = truth.boxes3d
    return boxes if boxes.ignore is None else boxes[~boxes.ignore]


def _points(sample: Sample) -> Float64:
    return np.concatenate([np.zeros((0, 3)), *(points.xyz for points in sample.placed("lidar"))])


def _hits(boxes: Boxes3D, xyz: Float64) -> Bool:
    """Whether points are inside, of each box that can be judged."""
    azimuth, found = np.arctan2(xyz[:, 1], xyz[:, 0]), []
    for center, size, yaw in zip(boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad, strict=True):
        beside = np.abs(np.angle(np.exp(1j * (azimuth - np.arctan2(center[1], center[0]))))) < _SIDE_RAD
        if np.hypot(center[0], center[1]) < _NEAR_M and beside.any():
            x, y, z = (xyz - center).T
            ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
            inside = (np.abs(ahead) < size[0] / 2 + _WIDER_M) & (np.abs(left) < size[1] / 2 + _WIDER_M)
            found.append(bool(np.any(inside & (np.abs(z) < _MIDDLE * size[2]))))
    return np.array(found, np.bool_)


@dataclass
class Measured:
    """Gathers what is found out about a log."""

    material: Material
    album: Album
    shown: list[Shown] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)

    def times(self, times: Sequence[SensorTimes]) -> None:
        """Draw the panel of times; remarks become verdicts."""
        text = (
            "Above, how far each message lies from the instant of its frame; below, how much later it was recorded. An "
            "offset shifts a line, a drift tilts it, a message that is in no frame shows only below."
        )
        self.shown.append(self.album.add("times", time_panel(self.material), text, "Times of all sensors"))
        self.verdicts += [Verdict(t.sensor, "time", remark, True) for t in times for remark in t.remarks]

    def mounting(self) -> None:
        """Draw the rig."""
        if self.material.rig.mounts:
            text = "Where sensors sit and look; red is x, green is y of each sensor's own axes."
            self.shown.append(self.album.add("rig", mounting(self.material.rig), text, "The rig from above"))

    def doppler(self) -> None:
        """Draw and judge the velocities of each radar whose place is known."""
        for radar in self.material.rig.sensors("radar"):
            period = self.material.periods_mps.get(radar)
            is_removed = self.material.info.metadata.get(f"radar.{radar}.ego_motion") == "removed"
            found = judged_of_doppler(self.material.kept, radar, period, is_removed)
            self.verdicts.append(Verdict(radar, "doppler", found.text, found.is_bad))
            panel = doppler_panel(self.material.samples, radar, period)
            if panel is not None:
                aliased = "" if period is None else f" Velocities alias with a period of {period:g} m/s."
                text = (
                    f"{radar}: stationary objects must lie on the yellow curve. Driving forward it sags in front; "
                    f"upside down the sign is wrong, flat at 0 the vehicle's own motion is removed.{aliased}"
                )
                stem = f"doppler-{self.album.stem(radar)}"
                self.shown.append(self.album.add(stem, panel, text, f"Radial velocity over azimuth of {radar}"))

    def labels(self) -> None:
        """Judge where truth is."""
        found = judged(self.material.samples)
        if found is not None:
            self.verdicts.append(Verdict("3D boxes", "truth", found.text, found.is_bad))

    def alignment(self) -> None:
        """Draw and judge how LiDARs fit each camera."""
        if not self.material.rig.sensors("lidar"):
            return
        for camera in self.material.rig.sensors("camera"):
            try:
                found = aligned(self.material.kept, camera)
            except LogError as error:
                self.gaps.append(f"{error}: nothing is drawn into its images")
                continue
            self.verdicts.append(Verdict(camera, "alignment", found.verdict, found.is_bad))
            seen = [s for s in self.material.samples if camera in s.cameras and s.placed("lidar")]
            sample = max(seen, key=lambda s: len(edges_of(s, camera)), default=None)
            if sample is not None:
                text = f"{camera}: {found.verdict}. Coloured jumps of depth must lie on bright edges of the image."
                stem = f"edges-{self.album.stem(camera)}"
                self.shown.append(self.album.add(stem, edges_view(sample, camera), text, f"Edges in {camera}"))

    def stereo(self) -> dict[int, list[Shown]]:
        """Draw and judge stereo pairs; returns the pictures by frame."""
        views: dict[int, list[Shown]] = {}
        for pair in pairs(self.material.rig):
            try:
                how = rectified(self.material.rig, pair)
            except LogError as error:
                self.gaps.append(str(error))
                continue
            found = [
                (s, stereo_view(s, pair, how))
                for s in self.material.samples
                if (pair.left in s.cameras and pair.right in s.cameras)
            ]
            self._judge_stereo(pair, how, [view for _, view in found])
            for sample, view in found:
                index, text = sample.frame.index, f"Stereo of {pair.left} and {pair.right}: {view.caption}."
                stem = f"{index:06d}-{self.album.stem(pair.left)}-stereo-{self.album.stem(pair.right)}"
                views.setdefault(index, []).append(self.album.add(stem, view.picture, text, "Depth by stereo"))
        return views

    def _judge_stereo(self, pair: Pair, how: Rectified, found: Sequence[StereoView]) -> None:
        if not found:
            self.gaps.append(f"stereo of {pair.left} and {pair.right}: no frame has both images")
            return
        about = f"{pair.left} + {pair.right}"
        share = sum(view.found_share for view in found) / len(found)
        base = f"baseline {how.baseline_m:.3f} m, depth for {share:.0%} of the pixels"
        errors = sorted(view.median_error for view in found if view.median_error is not None)
        biases = sorted(view.median_bias for view in found if view.median_bias is not None)
        if errors:
            error, bias = errors[len(errors) // 2], biases[len(biases) // 2]
            base += f", median relative difference from LiDAR {error:.1%} (bias {bias:+.1%})"
        self.verdicts.append(
            Verdict(about, "stereo", base, share < 0.2 or bool(errors and errors[len(errors) // 2] > 0.1))
        )
