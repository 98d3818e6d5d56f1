"""Logs of a training whose LiDARs and radars were measured frame by frame, and their images with the points in them."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from fbench.pipelines.models.samples import Sample, by_kind, can_decode, gather, make_sample, require_objects
from fbench.pipelines.sensors.bev.grid import BevPoints
from fbench.pipelines.sensors.bev.stage import BevInput, BevMeasurement
from fbench.pipelines.sensors.camera.channels import project_points
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
from fbench.replay.setup.source import LogRequest, log_source


@dataclass(frozen=True, eq=False)
class MeasuredLog:
    """A log, what its LiDARs and radars measured in each frame, and what is true there."""

    rig: Rig
    info: LogInfo
    frames: Mapping[int, Frame]
    points: Mapping[int, tuple[BevMeasurement, BevPoints, Plane]]
    truths: Sequence[tuple[int, Truth]]


def measure_log(path: Path, faults: FaultLog) -> MeasuredLog:
    """Read a log; what is wrong with its data is counted. Raises LogError where it has no LiDAR or radar."""
    source = log_source(LogRequest(path))
    reader = source.open(faults)
    sync = source.sync_params(None, None, None, None)
    stream = FrameStream(reader, sync, source.stamps(None, ()), Excerpt(), Clock(), faults)
    rig, info = reader.rig, reader.info
    kinds = {rig.mounts[name].kind for name in rig.sensors("lidar", "radar")}
    sensors = "both" if len(kinds) == 2 else next(iter(kinds), "both")
    prepare = BevInput(rig, info, sensors, LidarParams(), RadarParams(), SensorSettings(Learned3DParams(), rig))
    frames, points, segment = {}, {}, 0
    for frame in stream.frames(reader):
        if frame.segment != segment:  # as in a replay, nothing is remembered beyond a gap
            prepare.reset()
            segment = frame.segment
        seen = prepare.measure(frame, StageClock())
        frames[frame.index], points[frame.index] = frame, (seen, *prepare.prepare(seen, StageClock()))
    return MeasuredLog(rig, info, frames, points, [(i, t) for i, t in stream.labels(reader) if i in frames])


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


def _pair_images(path: Path) -> tuple[list[Sample], StagedFaults]:
    faults = StagedFaults()
    log, found = measure_log(path, faults), []
    truths = [(index, truth.boxes2d) for index, truth in log.truths if truth.boxes2d is not None]
    labeled = sorted({str(camera) for _, boxes in truths for camera in boxes.camera})
    for index, boxes in truths:
        seen, _, plane = log.points[index]
        for camera in labeled:
            image = log.frames[index].messages.get(camera)
            if isinstance(image, Image) and can_decode(image, path, faults):
                found.append(make_sample(log.info, image, boxes, project_points(log.rig, camera, seen, plane)))
    return found, faults
