"""Small logs and runs whose boxes are known, and exports of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.boxes import Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Message, PointCloud, Pose, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.formats.export import Export, Exported, export
from fbench.replay.formats.export_request import make_export_request
from fbench.replay.formats.open import open_boxes
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.coordinate_frames import CoordinateFrames, tree_of
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import BoxSource

STEP_NS = 100_000_000
UPRIGHT = np.array([0.0, 0, 0, 1])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])
CAMERA = CameraModel(np.array([[700.0, 0, 600], [0, 700, 180], [0, 0, 1]]), (1242, 375))


def rig(*cameras: str) -> Rig:
    """Cameras at the body's origin that look ahead, and a LiDAR."""
    names = cameras or ("cam",)
    mounts = {"lidar": Mount("lidar", np.zeros(3), UPRIGHT)}
    mounts |= {name: Mount("camera", np.zeros(3), FORWARD) for name in names}
    return Rig(mounts, dict.fromkeys(names, CAMERA))


def stamp(i: int) -> int:
    return 1_000_000_000 + i * STEP_NS


def sweeps(num: int, numbers: Sequence[int | None] | None = None) -> list[Message]:
    """One point each."""
    counted = [None] * num if numbers is None else numbers
    point = np.ones((1, 3), np.float32)
    return [PointCloud("lidar", stamp(i), stamp(i), point, frame_number=counted[i]) for i in range(num)]


def poses(num: int, translation_m: object, rotation_xyzw: object) -> list[Message]:
    """The same at each frame."""
    where, turn = np.array(translation_m, np.float64), np.array(rotation_xyzw, np.float64)
    return [Pose("body", stamp(i), stamp(i), where, turn) for i in range(num)]


def write_log(
    path: Path, items: Sequence[Message | Truth], metadata: Mapping[str, str] | None = None, of: Rig | None = None
) -> Path:
    with McapWriter(path, LogInfo(path.stem, f"made-{path.stem}", metadata or {}), of or rig()) as writer:
        for item in sorted(items, key=lambda item: item.log_ns):
            writer.write(item)
    return path


class Given:
    """A pipeline that gives what the test says, by frame."""

    def __init__(self, detections: Callable[[int], Boxes], tracks: Callable[[int], Boxes]) -> None:
        self._detections, self._tracks = detections, tracks

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Nothing to do."""

    def reset(self, reason: str) -> None:
        """Nothing to do."""

    def step(self, frame: Frame) -> Output:
        return Output(self._detections(frame.index), self._tracks(frame.index), {})


def run_of(
    log: Path, detections: Callable[[int], Boxes], tracks: Callable[[int], Boxes] | None = None, redact: bool = False
) -> Path:
    """Replay a log; returns the run folder, beside it."""
    faults = FaultLog()
    plan = Plan(Given(detections, tracks or detections), "given", redact=redact, num_media=0)
    return replay(open_log(log, faults), plan, log.with_name(f"run-{log.stem}"), faults, overwrite=True)


def solids(x: Sequence[float], **fields: object) -> Boxes3D:
    """Cars ahead at these distances [m], their middles on the axis of the camera."""
    num = len(x)
    center = np.stack([np.array(x, np.float64), np.zeros(num), np.zeros(num)], axis=1)
    boxes = Boxes3D(center, np.tile([4.0, 1.8, 1.5], (num, 1)), np.zeros(num), label=np.full(num, "car"))
    return replace(boxes, **{name: np.array(value) for name, value in fields.items()})  # type: ignore[arg-type]


def flats(num: int, **fields: object) -> Boxes2D:
    """Boxes beside each other in the image."""
    xyxy = np.array([[100.25 * i, 10.5, 100.25 * i + 40, 60.125] for i in range(num)]).reshape(-1, 4)
    boxes = Boxes2D(np.full(num, "cam"), xyxy, label=np.full(num, "car"))
    return replace(boxes, **{name: np.array(value) for name, value in fields.items()})  # type: ignore[arg-type]


def exported(form: str, out: Path, *sources: Path, overwrite: bool = False, name: str = "", **asked: str) -> Exported:
    """Export, and return what was said of the last source."""
    made = make_export_request(
        form, asked.get("boxes"), asked.get("camera", ""), asked.get("frame", ""), asked.get("class_name", "")
    )
    job = Export(sources, made, out, overwrite, name)
    return list(export(job, FaultLog()))[-1]


def read(path: Path, form: str, *cameras: str, frame: str = "", camera: str = "") -> list[Truth]:
    """Read a file of boxes with the rig of these logs."""
    known = rig(*cameras)
    frames = CoordinateFrames(known, tree_of(known), "body", {}, "world")
    return list(open_boxes(BoxSource(path, form, frame, camera), frames, FaultLog()).truths())


def log_of_labels(path: Path, out: Path, form: str = "kitti-tracking") -> Path:
    """A log of KITTI's labels as its importer makes it, from a file or folder."""
    truths = []
    for truth in read(path, form, "image_02", frame="image_02"):
        number = truth.frame_number or 0
        alphas = _alphas(path, form, number)
        flat = truth.boxes2d
        if flat is not None and len(flat):
            flat = replace(flat, attribute=np.array(alphas, np.str_))
        at_ns = stamp(number)
        truths.append(replace(truth, stamp_ns=at_ns, log_ns=at_ns, boxes2d=flat, frame_index=None))
    benchmark = "tracking" if form == "kitti-tracking" else "object"
    return write_log(out, truths, {"kitti.camera0": "body", "benchmark": benchmark}, rig("image_02"))


def _alphas(path: Path, form: str, number: int) -> list[str]:
    if form == "kitti-tracking":
        rows = [line.split() for line in path.read_text().splitlines()]
        rows = [row[2:] for row in rows if int(row[0]) == number]
    else:
        rows = [line.split() for line in (path / f"{number:06d}.txt").read_text().splitlines()]
    return ["" if row[0] == "DontCare" else f"alpha={row[3]}" for row in rows]
