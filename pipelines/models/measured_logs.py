"""Logs of a training whose LiDARs and radars were measured frame by frame, and their images with the points in them."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from fbench.pipelines.models.samples import Sample, by_kind, can_decode, gather, make_sample, require_objects
from fbench.pipelines.sensors.bev.grid import BevPoints
from fbench.pipelines.sensors.bev.stage import BevInput, BevMeasurement
from fbench.pipelines.sensors.camera.channels import ImagePoints, project_points
from fbench.pipelines.sensors.lidar.clusters import LidarParams
from fbench.pipelines.sensors.points.ground import Plane
from fbench.pipelines.sensors.radar.stage import RadarParams
from fbench.pipelines.variants.learned3d import Learned3DParams
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.faults import FaultLog, StagedFaults
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frames import FrameStream
from fbench.replay.geometry.camera import can_project, require_projection
from fbench.replay.setup.source import LogRequest, log_source

Kept = TypeVar("Kept")


@dataclass(frozen=True, eq=False)
class MeasuredFrame:
    """A frame, what its LiDARs and radars measured, and the sensors with which they did."""

    frame: Frame
    rig: Rig
    measured: BevMeasurement
    points: BevPoints
    plane: Plane  # The ground, which earlier frames showed where this one doesn't


def measure_log(
    path: Path, model: str, keep: Callable[[MeasuredFrame], Kept], faults: FaultLog
) -> tuple[LogInfo, list[tuple[Kept, Truth]]]:
    """Read a log, and return what is to be kept of each frame with truth, and the truth; what is wrong with its data is
    counted. Truth comes after the frames, so until then something is kept of each. Raises LogError where there is no
    LiDAR or radar.
    """
    source = log_source(LogRequest(path))
    reader = source.open(faults)
    sync = source.sync_params(None, None, None, None)
    stream = FrameStream(reader, sync, source.stamps(None, ()), Excerpt(), Clock(), faults)
    rig, info = stream.rig, reader.info
    prepare, kept, segment = _prepare(model, rig, info), dict[int, Kept](), 0
    for frame in stream.frames(reader):
        if stream.rig is not rig:  # measured by other sensors, or by the same ones calibrated anew
            rig, prepare = stream.rig, _prepare(model, stream.rig, info)
        elif frame.segment != segment:  # as in a replay, nothing is remembered beyond a gap
            prepare.reset()
        segment = frame.segment
        seen = prepare.measure(frame, StageClock())
        kept[frame.index] = keep(MeasuredFrame(frame, rig, seen, *prepare.prepare(seen, StageClock())))
    return info, [(kept[index], truth) for index, truth in stream.labels(reader) if index in kept]


def _prepare(model: str, rig: Rig, info: LogInfo) -> BevInput:
    kinds = {rig.mounts[name].kind for name in rig.sensors("lidar", "radar")}
    sensors = "both" if len(kinds) == 2 else next(iter(kinds), "both")
    return BevInput(model, rig, info, sensors, LidarParams(), RadarParams(), SensorSettings(Learned3DParams(), rig))


def rgbd_samples(logs: Sequence[Path], threads: int, faults: FaultLog) -> list[Sample]:
    """Read all images of logs with the points that their cameras would see, where there is 2D truth; corrupt ones, and
    what else is wrong with the data, are counted in `faults`. Raises LogError where there are none, nothing is to be
    found, no point lies in any, or a log has no LiDAR or radar.
    """
    with ThreadPoolExecutor(threads, "fbench-logs") as pool:
        found = require_objects(gather(pool.map(_pair_images, logs), faults))
    for where, own in by_kind(found):
        if not any(len(one.points.lidar) or len(one.points.radar) for one in own):
            raise LogError(
                f"no point or echo lies in any image of {where}: nothing to learn; is the calibration right?"
            )
    return found


@dataclass(frozen=True, eq=False)
class _Images:
    """The images of one frame, and the points in those of cameras that can be projected into."""

    rig: Rig
    images: Mapping[str, Image]
    points: Mapping[str, ImagePoints]


def _keep_images(of: MeasuredFrame) -> _Images:
    images = {name: m for name, m in of.frame.messages.items() if isinstance(m, Image)}
    seen = {name: project_points(of.rig, name, of.measured, of.plane) for name in images if can_project(of.rig, name)}
    return _Images(of.rig, images, seen)


def _pair_images(path: Path) -> tuple[list[Sample], StagedFaults]:
    faults, found = StagedFaults(), list[Sample]()
    info, frames = measure_log(path, "detector=rgbd", _keep_images, faults)
    truths = [(kept, truth.boxes2d) for kept, truth in frames if truth.boxes2d is not None]
    labeled = sorted({str(camera) for _, boxes in truths for camera in boxes.camera})
    for kept, boxes in truths:
        for camera in labeled:
            image = kept.images.get(camera)
            if image is not None and can_decode(image, path, faults):
                require_projection(kept.rig, camera)
                found.append(make_sample(info, image, boxes, kept.points[camera]))
    return found, faults
