"""Pictures and verdicts about a whole log, with radial velocity over azimuth."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.contracts.errors import LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.images import Pixels
from fbench.replay.data.scores import format_count
from fbench.replay.geometry.ego_velocity import (
    INLIER_MPS,
    EgoFit,
    Motion,
    decide_motion,
    fit_ego,
    read_motion,
    wrap_velocity,
)
from fbench.replay.geometry.stereo_pairs import pairs
from fbench.reports.preview import draw
from fbench.reports.preview.alignment import align, edges_of, edges_view
from fbench.reports.preview.collect import Album, Shown, Verdict
from fbench.reports.preview.draw import CURVE, of_speed
from fbench.reports.preview.sample import Material, Sample
from fbench.reports.preview.stereo import rectify_each, stereo_view
from fbench.reports.preview.times import Axes, SensorTimes, span_axes, time_panel
from fbench.reports.preview.views import mounting

_COLUMNS, _CELL = 3, (426, 270)
_MIN_SHARE = 0.3
_EGO_MOVING_MPS = 1.5
_NEAR_M, _FAR_M = 25.0, 150.0
"""Nearer boxes should hold points, unless they are hidden; nobody labels what is farther away."""
_MIDDLE, _WIDER_M = 0.3, 0.5
"""Points count in this share of a box's height above and below its middle, so that the ground doesn't, and that far
beside it, since the vehicle moves during a sweep."""
_SIDE_RAD = 0.1
_FEW, _MEASURE_MIN_SHARE = 5, 0.5
_MOST_JUDGED = 200  # Boxes within `_NEAR_M` of one frame, against all its points; more tell nothing new


@dataclass(frozen=True, eq=False)
class _Scan:
    """One scan as seen from its radar, in body axes."""

    index: int
    azimuth_rad: Float64
    speed_mps: Float64
    fit: EgoFit | None
    ego_mps: float | None


def check_doppler(samples: Sequence[Sample], radar: str, period_mps: float | None, is_removed: bool = False) -> Verdict:
    """Judge sign, ego motion and aliasing of a radar's velocities, which alias with a period, or as far as is known
    don't (`None`); `is_removed`: the log says that they don't hold the vehicle's own motion.
    """
    scans = _scans(samples, radar, period_mps)
    text, is_bad = _is_motion_removed(scans) if is_removed and scans else _judge(scans, period_mps)
    return Verdict(radar, "doppler", text, is_bad)


def doppler_panel(samples: Sequence[Sample], radar: str, period_mps: float | None) -> Pixels | None:
    """Draw the scans of all samples; `None` where there is none with velocities."""
    scans = _scans(samples, radar, period_mps)
    if not scans:
        return None
    rows = -(-len(scans) // _COLUMNS)
    picture = draw.canvas(_CELL[0] * min(_COLUMNS, len(scans)), _CELL[1] * rows)
    azimuth = span_axes(np.degrees(np.concatenate([scan.azimuth_rad for scan in scans])), 20)
    reach = max(2.0, *(abs(v) for v in span_axes(np.concatenate([scan.speed_mps for scan in scans]), 4)))
    for number, scan in enumerate(scans):
        at = (number % _COLUMNS * _CELL[0], number // _COLUMNS * _CELL[1])
        _draw_scan(picture, Axes((*at, *_CELL), azimuth, (-reach, reach)), scan, period_mps)
    return picture


def _scans(samples: Sequence[Sample], radar: str, period_mps: float | None) -> list[_Scan]:
    scans = []
    for sample in samples:
        for points in sample.points_of("radar"):
            if points.sensor == radar and np.isfinite(points.speed_mps).any():
                seen = points.xyz - sample.rig.body_T_sensor(radar)[:3, 3]
                distance = np.sqrt(np.sum(seen**2, axis=1))
                rows = (distance > 0.5) & np.isfinite(points.speed_mps)
                directions, speed = seen[rows] / distance[rows, None], points.speed_mps[rows]
                azimuth = np.arctan2(directions[:, 1], directions[:, 0])
                fit = fit_ego(directions, speed, period_mps)
                scans.append(_Scan(sample.frame.index, azimuth, speed, fit, sample.ego_mps))
    return scans


def _draw_scan(picture: Pixels, axes: Axes, scan: _Scan, period_mps: float | None) -> None:
    fit = scan.fit
    title = f"frame {scan.index}: {format_count(len(scan.speed_mps), 'point')}"
    if fit is not None:
        title += f", curve: {fit.velocity_mps[0]:+.1f} m/s ahead, {fit.share:.0%} agree"
    axes.draw(picture, title, "azimuth [deg], left is +", "radial velocity [m/s], receding is +")
    if fit is not None:
        angles = np.radians(np.linspace(axes.x[0], axes.x[1], 241))
        curve = wrap_velocity(fit.radial_mps(angles), period_mps)
        if period_mps is not None:
            curve[1:][np.abs(np.diff(curve)) > period_mps / 2] = np.nan
        axes.line(picture, np.stack([np.degrees(angles), curve], axis=1), CURVE, 2)
    xy = np.stack([np.degrees(scan.azimuth_rad), scan.speed_mps], axis=1)
    axes.dots(picture, xy, of_speed(scan.speed_mps), 2)


def _judge(scans: Sequence[_Scan], period_mps: float | None) -> tuple[str, bool]:
    fits = [scan.fit for scan in scans if scan.fit is not None]
    if not scans:
        why = "radar3d can't tell what moves, and takes strong clusters of a vehicle's size"
        return f"no radial velocities: {why}", False
    if not fits:
        return "too few points to judge the velocities", False
    if (period := _unknown_period(scans)) if period_mps is None else 0.0:
        return f"velocities seem to alias with a period of about {period:.1f} m/s: set velocity_period_mps", True
    share = float(np.median([fit.share for fit in fits]))
    if share < _MIN_SHARE:
        why = "wrong mounting, units or sign by direction, no stationary objects, or velocities without period"
        return f"no speed of the vehicle explains the points ({share:.0%} agree at best): {why}", True
    egos = [scan.ego_mps for scan in scans if scan.ego_mps is not None]
    ego = float(np.median(egos)) if egos else None
    motion, shown = _find_motion(scans)
    if motion == "unknown":
        return _unclear(shown), False
    if motion != "included":
        return _still(ego)
    moving = [scan.fit for scan, one in zip(scans, shown, strict=True) if scan.fit is not None and one == "included"]
    speed = float(np.median([fit.velocity_mps[0] for fit in moving]))
    agree = f"{float(np.median([fit.share for fit in moving])):.0%} of the points agree"
    rivals = float(np.median([fit.share - fit.opposite_share for fit in moving]))
    return _moving(speed, ego, agree, is_clear=rivals > 0.05)


def _find_motion(scans: Sequence[_Scan]) -> tuple[Motion, list[Motion]]:
    """Return what the scans show together, and one by one."""
    shown = [read_motion(s.fit, s.ego_mps is not None and abs(s.ego_mps) > _EGO_MOVING_MPS) for s in scans]
    return decide_motion(shown), shown


def _unclear(shown: Sequence[Motion]) -> str:
    num = len(shown) - shown.count("unknown")
    few = f"{num} of {len(shown)} scans {'shows' if num == 1 else 'show'} clearly how the vehicle moves"
    return f"unknown: {few}, and not enough agree; set doppler and ego_motion in fbench.toml as the radar's manual says"


def _is_motion_removed(scans: Sequence[_Scan]) -> tuple[str, bool]:
    motion, shown = _find_motion(scans)
    share = float(np.median([np.mean(np.abs(scan.speed_mps) < INLIER_MPS) for scan in scans]))
    if motion == "included":
        return f"the vehicle's own motion is said to be removed, but only {share:.0%} of the points stand still", True
    if motion == "unknown":
        return _unclear(shown), False
    return f"the vehicle's own motion is removed, as said: {share:.0%} of the points stand still", False


def _still(ego: float | None) -> tuple[str, bool]:
    if ego is not None and abs(ego) > _EGO_MOVING_MPS:
        removed = 'the vehicle\'s own motion has been removed already: set ego_motion = "removed"'
        return f"most points don't move though the vehicle drives at {ego:.1f} m/s: {removed}", True
    if ego is not None:
        return "most points don't move, and the vehicle doesn't, as its poses say", False
    removed = 'or its own motion has been removed already (then set ego_motion = "removed")'
    return f"most points don't move relative to the radar: the vehicle stands, {removed}", False


def _moving(speed: float, ego: float | None, agree: str, is_clear: bool) -> tuple[str, bool]:
    """Judge the sign."""

    def way(speed: float) -> str:
        return "forward" if speed > 0 else "backwards"

    flip = "the sign is the other way round: change doppler in fbench.toml"
    found = f"stationary points say that the vehicle drives {way(speed)} at {abs(speed):.1f} m/s ({agree})"
    if ego is not None and abs(ego) > _EGO_MOVING_MPS:
        told = f"its poses say {way(ego)} at {abs(ego):.1f} m/s"
        if speed * ego < 0 and abs(speed + ego) < max(2.0, 0.3 * abs(ego)):
            return f"{found}, {told}: {flip}", True
        near = abs(speed - ego) < max(1.0, 0.2 * abs(ego))
        return (f"{found}, as its poses do", False) if near else (f"{found}, but {told}", True)
    if not is_clear:
        return f"{found}; because of aliasing the other direction fits about as well, so look at the curves", False
    return (f"{found}; unless it does, {flip}", True) if speed < 0 else (found, False)


def _unknown_period(scans: Sequence[_Scan]) -> float:
    """Period [m/s] that explains clearly more points than none does: twice the fastest velocity; 0 where none does."""
    top = float(np.quantile(np.abs(np.concatenate([scan.speed_mps for scan in scans])), 0.995))
    if top < 1.0:
        return 0.0
    gains = []
    for scan in scans:
        if scan.fit is not None:
            directions = np.stack([np.cos(scan.azimuth_rad), np.sin(scan.azimuth_rad), 0 * scan.azimuth_rad], axis=1)
            other = fit_ego(directions, scan.speed_mps, 2 * top)
            gains.append(0.0 if other is None else other.share - scan.fit.share)
    return 2 * top if gains and float(np.median(gains)) > 0.2 else 0.0


def check_labels(samples: Sequence[Sample]) -> Verdict | None:
    """Count the boxes that hold points, among those near the body in whose direction a LiDAR sees something."""
    away, hits = [np.zeros(0)], []
    for sample in samples:
        truth = sample.truth
        if truth is None or truth.boxes3d is None or truth.in_world:
            continue
        boxes = truth.boxes3d if truth.boxes3d.ignore is None else truth.boxes3d[~truth.boxes3d.ignore]
        away.append(np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1]))
        hits += _hits(boxes, np.concatenate([np.zeros((0, 3)), *(points.xyz for points in sample.points_of("lidar"))]))
    distance_m = np.concatenate(away)
    if len(distance_m) and (nearest := float(np.min(distance_m))) > _FAR_M:
        why = "wrong coordinate frame, or poses of another one?"
        text = f"the nearest of {format_count(len(distance_m), 'box', 'boxes')} is {nearest:.0f} m away: {why}"
        return Verdict("3D boxes", "truth", text, True)
    if len(hits) < _FEW:
        return None
    text = f"{sum(hits)} of {len(hits)} boxes within {_NEAR_M:g} m hold LiDAR points above the ground"
    is_bad = sum(hits) / len(hits) <= _MEASURE_MIN_SHARE
    return Verdict("3D boxes", "truth", text + (": wrong coordinate frame, stamps or sizes?" if is_bad else ""), is_bad)


def _hits(boxes: Boxes3D, xyz: Float64) -> list[bool]:
    """Whether points are inside, of each box that can be judged."""
    azimuth, hits = np.arctan2(xyz[:, 1], xyz[:, 0]), []
    near = np.flatnonzero(np.hypot(boxes.center_m[:, 0], boxes.center_m[:, 1]) < _NEAR_M)[:_MOST_JUDGED]
    for center, size, yaw in zip(boxes.center_m[near], boxes.size_lwh_m[near], boxes.yaw_rad[near], strict=True):
        turn = np.abs(azimuth - np.arctan2(center[1], center[0]))
        if (np.minimum(turn, 2 * np.pi - turn) < _SIDE_RAD).any():
            x, y, z = (xyz - center).T
            ahead, left = np.cos(yaw) * x + np.sin(yaw) * y, np.cos(yaw) * y - np.sin(yaw) * x
            inside = (np.abs(ahead) < size[0] / 2 + _WIDER_M) & (np.abs(left) < size[1] / 2 + _WIDER_M)
            hits.append(bool(np.any(inside & (np.abs(z) < _MIDDLE * size[2]))))
    return hits


@dataclass
class Measured:
    """Gathers what is found out about a log."""

    material: Material
    album: Album
    shown: list[Shown] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    gaps: list[str] = field(default_factory=list)

    def _show(self, stem: str, pixels: Pixels, caption: str, alt: str) -> None:
        self.shown.append(self.album.add(stem, pixels, caption, alt))

    def times(self, times: Sequence[SensorTimes]) -> None:
        """Draw the panel of times; remarks become verdicts."""
        text = (
            "Above, how far each message lies from the instant of its frame; below, how much later it was recorded. An "
            "offset shifts a line, a drift tilts it, a message that is in no frame shows only below."
        )
        self._show("times", time_panel(self.material), text, "Times of all sensors")
        self.verdicts += [Verdict(t.sensor, "time", remark, True) for t in times for remark in t.remarks]

    def mounting(self) -> None:
        """Draw the rig."""
        if self.material.rig.mounts:
            text = "Where sensors sit and look; red is x, green is y of each sensor's own axes."
            self._show("rig", mounting(self.material.rig), text, "The rig from above")

    def doppler(self) -> None:
        """Draw and judge the velocities of each radar whose place is known."""
        for radar in self.material.rig.sensors("radar"):
            period = self.material.periods_mps.get(radar)
            is_removed = self.material.info.metadata.get(f"radar.{radar}.ego_motion") == "removed"
            self.verdicts.append(check_doppler(self.material.kept, radar, period, is_removed))
            panel = doppler_panel(self.material.samples, radar, period)
            if panel is not None:
                aliased = "" if period is None else f" Velocities alias with a period of {period:g} m/s."
                text = (
                    f"{radar}: stationary objects must lie on the yellow curve. Driving forward it sags in front; "
                    f"upside down the sign is wrong, flat at 0 the vehicle's own motion is removed.{aliased}"
                )
                self._show(f"doppler-{self.album.stem(radar)}", panel, text, f"Radial velocity over azimuth of {radar}")

    def labels(self) -> None:
        """Judge where truth is."""
        if (verdict := check_labels(self.material.samples)) is not None:
            self.verdicts.append(verdict)

    def alignment(self) -> None:
        """Draw and judge how LiDARs fit each camera."""
        for camera in self.material.rig.sensors("camera") if self.material.rig.sensors("lidar") else ():
            try:
                found = align(self.material.kept, camera)
            except LogError as error:
                self.gaps.append(f"{error}: nothing is drawn into its images")
                continue
            self.verdicts.append(Verdict(camera, "alignment", found.verdict, found.is_bad))
            seen = [s for s in self.material.samples if camera in s.cameras and s.points_of("lidar")]
            sample = max(seen, key=lambda s: len(edges_of(s, camera)), default=None)
            if sample is not None:
                text = f"{camera}: {found.verdict}. Colored jumps of depth must lie on bright edges of the image."
                stem = f"edges-{self.album.stem(camera)}"
                self._show(stem, edges_view(sample, camera), text, f"Edges in {camera}")

    def stereo(self) -> dict[int, list[Shown]]:
        """Draw and judge stereo pairs; returns the pictures by frame."""
        pictures: dict[int, list[Shown]] = {}
        for pair in pairs(self.material.rig):
            names = {pair.left, pair.right}
            both = [s for s in self.material.samples if names <= set(s.cameras) & s.rig.cameras.keys()]
            if not both:
                self.gaps.append(f"stereo of {pair.left} and {pair.right}: no frame has both images")
                continue
            try:
                rectified = rectify_each(both, pair)
            except LogError as error:
                self.gaps.append(str(error))
                continue
            views = [stereo_view(sample, pair, how) for sample, how in zip(both, rectified, strict=True)]
            share = sum(view.found_share for view in views) / len(views)
            text = f"baseline {rectified[0].baseline_m:.3f} m, depth for {share:.0%} of the pixels"
            errors = sorted(view.median_error for view in views if view.median_error is not None)
            biases = sorted(view.median_bias for view in views if view.median_bias is not None)
            is_bad = share < 0.2
            if errors:
                off, bias = errors[len(errors) // 2], biases[len(biases) // 2]
                text += f", median relative difference from LiDAR {off:.1%} (bias {bias:+.1%})"
                is_bad = is_bad or off > 0.1
            self.verdicts.append(Verdict(f"{pair.left} + {pair.right}", "stereo", text, is_bad))
            for sample, view in zip(both, views, strict=True):
                index, text = sample.frame.index, f"Stereo of {pair.left} and {pair.right}: {view.caption}."
                stem = f"{index:06d}-{self.album.stem(pair.left)}-stereo-{self.album.stem(pair.right)}"
                kept = pictures.setdefault(index, [])
                kept.append(self.album.add(stem, view.picture, text, "Depth by stereo"))
                text = f"LiDAR on the left, points by stereo of {pair.left} and {pair.right} on the right, from above."
                kept.append(self.album.add(f"{stem}-cloud", view.cloud, text, "Points by stereo and LiDAR"))
        return pictures
