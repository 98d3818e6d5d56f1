"""Every pipeline that comes with fbench, and a drive whose sensors show each of them something."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from tests.pipelines.frames import CAMERA, MOUNTS, UPRIGHT, image
from tests.pipelines.networks import encode_pixels
from tests.pipelines.scenes import car_back, echoes, radial, road, surroundings
from tests.pipelines.sensors.stereo import pairs

from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.contracts.protocols import UsesLog
from fbench.replay.data.arrays import Float64
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Message, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo, Rig

LOG = LogInfo("drive", "id")
STEP_NS = 100_000_000
PAIR = pairs.rig()
LOW = ("lidar.crop.low_m=-1.4", "radar.crop.low_m=-1.4", "radar.size.least_height_m=0")
"""For the thesis's configurations, whose ground is a height: here the body's origin is 1.6 m above it."""
ONE_PAIR = ("stereo.disparity.shrink=1",)
RGBD = "detector=rgbd"


@dataclass(frozen=True)
class Case:
    """A pipeline, the kinds of sensors that it uses, and what these frames need."""

    name: str
    uses: str
    settings: tuple[str, ...] = ()

    @property
    def flat(self) -> bool:
        return self.name.endswith("2d")

    def __str__(self) -> str:
        return self.name if RGBD not in self.settings else f"{self.name}-rgbd"


CASES = (
    Case("camera2d", "C"), Case("lidar2d", "L"), Case("radar2d", "R", ("min_score=0.3",)), Case("lidar3d", "L"),
    Case("radar3d", "R"), Case("stereo3d", "S", ONE_PAIR), Case("early2d", "CLR"), Case("early3d", "CLR"),
    Case("early2d", "CLR", (RGBD, "rgbd.min_score=0.3")),
    Case("late2d", "CLR"), Case("late3d", "CLR"), Case("track", "D"), Case("learned3d", "LR"),
    Case("thesis/camera2d", "C"), Case("thesis/lidar2d", "L", LOW), Case("thesis/radar2d", "R", LOW),
    Case("thesis/lidar3d", "L", LOW), Case("thesis/radar3d", "R", LOW), Case("thesis/early2d", "CLR", LOW),
    Case("thesis/early3d", "CLR", LOW), Case("thesis/early3d-stereo", "CLRS", LOW),
    Case("thesis/late2d", "CLR", LOW), Case("thesis/late2d-stereo", "CLRS", LOW), Case("thesis/late3d", "CLR", LOW),
)  # fmt: skip


@dataclass
class Results:
    """A log with another system's boxes; implements `BoxReader`."""

    found: Sequence[Truth]
    poses: tuple[str, ...] = ()

    def body_poses(self) -> Iterator[Pose]:
        yield from ()

    def detections(self, topic: str) -> Iterator[Truth]:
        yield from self.found


@lru_cache
def pictures() -> Mapping[str, Message]:
    """What a stereo pair sees of a car 9 m ahead."""
    return pairs.frame(PAIR, [pairs.road(), pairs.wall(30.0), *pairs.car(9.0, 1.0)]).messages


def drive(case: Case, num: int) -> list[Frame]:
    """Frames of a vehicle that follows a car, 8 m/s against 3 m/s; stereo sees another one."""
    return [Frame(i, i * STEP_NS, 0, {m.sensor: m for m in _measured(case, i)}) for i in range(num)]


def _measured(case: Case, index: int) -> Iterator[Message]:
    stamp_ns, x_m = index * STEP_NS, 20.0 - 5.0 * index * STEP_NS * 1e-9
    if "C" in case.uses or case.flat:
        yield replace(image(), stamp_ns=stamp_ns)
    if "L" in case.uses:
        xyz = np.concatenate([road(), car_back(x_m, 0.0), car_side(x_m, 0.9)]).astype(np.float32)
        yield PointCloud("lidar", stamp_ns, stamp_ns, xyz)
    if "R" in case.uses:
        car, rest = echoes(x_m, 0.0), surroundings()
        rate = np.concatenate([radial(car, 8.0, 3.0), radial(rest, 8.0)]).astype(np.float32)
        xyz = np.concatenate([car, rest]).astype(np.float32)
        yield RadarScan("radar", stamp_ns, stamp_ns, xyz, rate, np.full(len(xyz), 60, np.float32))
    if "S" in case.uses:
        yield from (replace(m, stamp_ns=stamp_ns, log_ns=stamp_ns) for m in pictures().values())
    yield Pose("pose", stamp_ns, stamp_ns, np.array([0.8 * index, 0, 0]), UPRIGHT)


def car_side(x_m: float, y_m: float) -> Float64:
    """Points on the left side of a car whose back is at `x_m`."""
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(0.1, 4.1, 12), (0.4, 0.8, 1.2)))
    return np.column_stack([x_m + x, np.full(len(x), y_m), z - 1.6])


def recorded(frames: Sequence[Frame]) -> list[Truth]:
    """Three cars and a pedestrian ahead, for each frame."""
    center = np.array([[20.0, 0, 0], [30, 4, 0], [12, -4, 0], [16, 7, 0]])
    size = np.array([[4.2, 1.8, 1.5]] * 3 + [[0.6, 0.6, 1.7]])
    label, score = np.array(["car"] * 3 + ["pedestrian"]), np.array([0.9, 0.8, 0.7, 0.9])
    boxes = Boxes3D(center, size, np.array([0, 0.1, 3.0, 0]), label=label, score=score)
    return [Truth(f.stamp_ns, f.stamp_ns, replace(boxes, center_m=center - [0.5 * f.index, 0, 0])) for f in frames]


def rig_of(case: Case) -> Rig:
    cameras = {"cam": CAMERA} if "C" in case.uses or case.flat else {}
    kinds = {"cam": "C" in case.uses or case.flat, "lidar": "L" in case.uses, "radar": "R" in case.uses}
    mounts = {name: MOUNTS[name] for name, is_there in kinds.items() if is_there}
    if "S" in case.uses:
        return Rig({**mounts, **PAIR.mounts}, {**cameras, **PAIR.cameras})
    return Rig(mounts or {"lidar": MOUNTS["lidar"]}, cameras)


def weights(case: Case, one_car: Path) -> tuple[str, ...]:
    """Settings that name the network of cameras."""
    if RGBD in case.settings:
        path = one_car.with_name("pixels.onnx")
        path.write_bytes(encode_pixels((62, 52), side_px=12.0))
        return (f"rgbd.weights={path}",)
    return (f"camera.weights={one_car}",) if "C" in case.uses else ()


def outputs(
    case: Case, one_car: Path, frames: Sequence[Frame], rig: Rig | None = None, results: Sequence[Truth] | None = None
) -> list[Output]:
    """Run a pipeline over frames that follow each other."""
    pipeline, _ = make_pipeline(case.name, [*case.settings, *weights(case, one_car)])
    if isinstance(pipeline, UsesLog):
        pipeline.use_log(Results(recorded(frames) if results is None else results))
    pipeline.start(rig or rig_of(case), LOG)
    pipeline.reset("start")
    return [pipeline.step(frame) for frame in frames]


def require_sound(found: Sequence[Output]) -> None:
    """Places and sizes are finite, scores in [0, 1], and all frames with boxes have the same fields."""
    for output in found:
        for boxes, first in ((output.detections, found[0].detections), (output.tracks, found[0].tracks)):
            assert not len(boxes) or boxes.arrays().keys() == first.arrays().keys()
            places = (
                (boxes.xyxy_px,) if isinstance(boxes, Boxes2D) else (boxes.center_m, boxes.size_lwh_m, boxes.yaw_rad)
            )
            assert all(np.isfinite(values).all() for values in places)
            assert boxes.score is None or ((boxes.score >= 0) & (boxes.score <= 1)).all()
