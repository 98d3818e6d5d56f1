"""Metamorphic relations: changes of frames after which a pipeline must give the same results, whatever is true.

A pipeline is wrapped such that it gets changed frames, and its results are changed back, so that both runs compare box
by box. After Chen et al. (1998), "Metamorphic testing"; for driving Zhou and Sun (CACM 2019).
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.protocols import Pipeline
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes, Boxes2D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.images import decode, encode_png
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.geometry.transforms import pose_matrix

_HOUR_NS, _AFTER_NS = 3_600_000_000_000, 1_000_000
_THINNED = 0.1  # Share of points that are left out
_TURN_RAD, _SHIFT_M = 1.0, np.array([500.0, -300.0, 0.0])
_LEFT_RIGHT = np.diag([1.0, -1.0, 1.0])  # Of body, LiDAR and radar, whose y is to the left
_IN_IMAGE = np.diag([-1.0, 1.0, 1.0])  # Of cameras, whose x is to the right
_RADIAL, _TANGENTIAL = ("", "fisheye", "equidistant"), ("plumb_bob", "rational_polynomial")
_P2, _MOST_COEFFICIENTS = 3, 8
"""Of k1, k2, p1, p2, k3 to k6, only p2 is along x, and changes its sign in a mirror; others may follow."""


class Relation:
    """A change of everything that a pipeline gets, which leaves its results as they are once they are changed back."""

    least: ClassVar[float] = 1.0
    """Agreement (F1) with the results for the original that must be reached."""

    def rig(self, rig: Rig) -> Rig:
        """Return the changed rig. Raises LogError where it can't be changed so."""
        return rig

    def frame(self, frame: Frame) -> Frame:
        """Return a changed frame."""
        return replace(frame, messages={name: self.message(m) for name, m in frame.messages.items()})

    def message(self, message: Message) -> Message:
        """Return a changed message."""
        return message

    def boxes(self, boxes: Boxes) -> Boxes:
        """Return results as they were for the original."""
        return boxes

    def repeat(self, frame: Frame) -> Frame | None:
        """Return the frame that comes after a changed one, and whose results count then; `None`: there is none."""
        return None


class _ShiftedClock(Relation):
    """All stamps are an hour later."""

    def frame(self, frame: Frame) -> Frame:
        return replace(super().frame(frame), stamp_ns=frame.stamp_ns + _HOUR_NS)

    def message(self, message: Message) -> Message:
        return replace(message, stamp_ns=message.stamp_ns + _HOUR_NS, log_ns=message.log_ns + _HOUR_NS)


class _RotatedWorld(Relation):
    """The world's axes are others: poses are turned and moved, what sensors see isn't."""

    least = 0.999

    def message(self, message: Message) -> Message:
        if not isinstance(message, Pose):
            return message
        turn = Rotation.from_rotvec([0.0, 0.0, _TURN_RAD])
        rotation = (turn * Rotation.from_quat(message.rotation_xyzw)).as_quat()
        moved = turn.as_matrix() @ message.translation_m + _SHIFT_M
        return replace(message, translation_m=moved, rotation_xyzw=rotation)


class _ThinnedPoints(Relation):
    """A tenth of the points of LiDARs and radars is missing, drawn for each message alone."""

    least = 0.85

    def message(self, message: Message) -> Message:
        if not isinstance(message, PointCloud | RadarScan):
            return message
        random = generator(0, "thinned", message.sensor, message.stamp_ns)
        kept = random.random(len(message.xyz)) >= _THINNED
        names = ["xyz", "intensity", "ring", "offset_ns"] if isinstance(message, PointCloud) else [
            "xyz", "radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad", "altitude_rad"]  # fmt: skip
        held = {name: getattr(message, name) for name in names}
        return replace(message, **{name: values[kept] for name, values in held.items() if values is not None})


class _FrameTwice(Relation):
    """One of ten frames comes again a millisecond later."""

    least = 0.95

    def repeat(self, frame: Frame) -> Frame | None:
        return replace(frame, stamp_ns=frame.stamp_ns + _AFTER_NS) if frame.index % 10 == 5 else None


class _Mirrored(Relation):
    """Left is right: points, images, mounts and poses are those that the world in a mirror would give."""

    least = 0.9

    def __init__(self) -> None:
        self._widths: dict[str, int] = {}

    def rig(self, rig: Rig) -> Rig:
        self._widths |= {name: camera.size_wh[0] for name, camera in rig.cameras.items()}
        mounts = {name: _mirror_mount(mount) for name, mount in rig.mounts.items()}
        return Rig(mounts, {name: _mirror_camera(name, c) for name, c in rig.cameras.items()}, rig.bare)

    def message(self, message: Message) -> Message:
        if isinstance(message, Image):
            self._widths[message.sensor] = message.size_wh[0]
            return _mirror_image(message)
        if isinstance(message, Pose):
            rotation = _LEFT_RIGHT @ message.world_T_body[:3, :3] @ _LEFT_RIGHT
            moved = _LEFT_RIGHT @ message.translation_m
            return replace(message, translation_m=moved, rotation_xyzw=Rotation.from_matrix(rotation).as_quat())
        xyz = message.xyz * np.array([1, -1, 1], np.float32)
        if isinstance(message, RadarScan) and message.azimuth_rad is not None:
            return replace(message, xyz=xyz, azimuth_rad=-message.azimuth_rad)
        return replace(message, xyz=xyz)

    def boxes(self, boxes: Boxes) -> Boxes:
        if isinstance(boxes, Boxes2D):
            last = np.array([self._widths[name] - 1.0 for name in boxes.camera.tolist()])
            visible = boxes.visible_xyxy_px
            seen = None if visible is None else _mirror_xyxy(visible, last)
            return replace(boxes, xyxy_px=_mirror_xyxy(boxes.xyxy_px, last), visible_xyxy_px=seen)
        velocity, roll = boxes.velocity_mps, boxes.roll_rad
        return replace(
            boxes, center_m=boxes.center_m @ _LEFT_RIGHT, yaw_rad=-boxes.yaw_rad,
            roll_rad=None if roll is None else -roll, velocity_mps=None if velocity is None else velocity @ _LEFT_RIGHT,
        )  # fmt: skip


def _mirror_mount(mount: Mount) -> Mount:
    own = _IN_IMAGE if mount.kind == "camera" else _LEFT_RIGHT
    rotation = _LEFT_RIGHT @ pose_matrix(np.zeros(3), mount.rotation_xyzw)[:3, :3] @ own
    moved = _LEFT_RIGHT @ mount.translation_m
    return replace(mount, translation_m=moved, rotation_xyzw=Rotation.from_matrix(rotation).as_quat())


def _mirror_camera(name: str, camera: CameraModel) -> CameraModel:
    K, bent = np.array(camera.K), np.array(camera.distortion)
    K[0, 2], K[0, 1] = camera.size_wh[0] - 1 - K[0, 2], -K[0, 1]
    if len(bent) > _MOST_COEFFICIENTS or camera.distortion_model not in (*_RADIAL, *_TANGENTIAL):
        raise LogError(f"camera '{name}' can't be mirrored: its lens ({camera.distortion_model}, {len(bent)} numbers)")
    if camera.distortion_model in _TANGENTIAL and len(bent) > _P2:
        bent[_P2] *= -1
    return replace(camera, K=K, distortion=bent)


def _mirror_image(image: Image) -> Image:
    pixels = decode(image)
    if pixels is None:
        return image  # can't be decoded by the pipeline, either
    data = encode_png(np.ascontiguousarray(pixels[:, ::-1]))
    return replace(image, data=data, encoding="png", video=None)


def _mirror_xyxy(xyxy_px: Float64, last: Float64) -> Float64:
    left, top, right, bottom = xyxy_px.T
    return np.column_stack([last - right, top, last - left, bottom])


RELATIONS: Mapping[str, tuple[type[Relation], str]] = {
    "clock": (_ShiftedClock, "an hour later"),
    "world": (_RotatedWorld, "other axes of the world"),
    "twice": (_FrameTwice, "one of ten frames twice"),
    "mirror": (_Mirrored, "left is right"),
    "thinned": (_ThinnedPoints, "a tenth of all points is missing"),
}
"""By name, those that must hold best first, with what is changed."""


class RelatedPipeline:
    """A pipeline that gets changed frames, and whose results are changed back."""

    def __init__(self, pipeline: Pipeline, relation: Relation) -> None:
        self._pipeline, self._relation = pipeline, relation

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Start it with the changed rig."""
        self._pipeline.start(self._relation.rig(rig), log_info)

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._pipeline.reset(reason)

    def step(self, frame: Frame) -> Output:
        """Process a changed frame."""
        changed = self._relation.frame(frame)
        output = self._pipeline.step(changed)
        if (again := self._relation.repeat(changed)) is not None:
            output = self._pipeline.step(again)
        tracks = None if output.tracks is None else self._relation.boxes(output.tracks)
        return replace(output, detections=self._relation.boxes(output.detections), tracks=tracks, digests={})
