"""The camera detector: one image in, labeled boxes out, by all cameras of a rig; timed."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import TypeAlias

import numpy as np

from fbench.pipelines.models.weights import AUTO, Weights, resolve
from fbench.pipelines.sensors.camera.families import RGB
from fbench.pipelines.sensors.camera.layouts import NO_CANDIDATES, SIDE_PX, Candidates, Placement, Size
from fbench.pipelines.sensors.camera.model import Batch, Model
from fbench.pipelines.sensors.camera.providers import INSTALL_LIBRARIES
from fbench.pipelines.sensors.rows import suppress
from fbench.replay.contracts.devices import use_device
from fbench.replay.contracts.errors import ConfigError, ModelError
from fbench.replay.contracts.params import CheckedParams, StageClock, in_range, require_between
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.contracts.settings import describe_file
from fbench.replay.data.arrays import Float64, Text, freeze_fields
from fbench.replay.data.boxes import VEHICLES
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image
from fbench.replay.data.metadata import SIMULATED
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.camera import require_projection
from fbench.replay.geometry.iou import common_areas, iou_2d
from fbench.replay.geometry.threads import num_threads


@dataclass(frozen=True)
class Thresholds:
    """All shares, 0 to 1. The defaults are for weights that say nothing."""

    min_score: float = 0.6
    nms_iou: float = 0.5
    nms_containment: float = 0.9


def thresholds(asked: Mapping[str, float | None], metadata: Mapping[str, str]) -> Thresholds:
    """Return what is asked for by name, else what the weights' metadata say under that name, else the defaults. Raises
    ModelError where metadata aren't numbers between 0 and 1; it names the entry, not the file.
    """
    said = {f.name: _share(f.name, metadata[f.name]) for f in fields(Thresholds) if f.name in metadata}
    return Thresholds(**(said | {name: value for name, value in asked.items() if value is not None}))


def _share(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise ModelError(f"metadata entry '{name}': expected a number between 0 and 1, got {text[:40]!r}")
    return value


Window = tuple[int, int, int, int]  # Left, top, right, bottom [px] of a part of an image; right and bottom are outside
MAX_WINDOWS = 8  # A longer image is cut into windows that are wider instead, so that a strip can't fill the memory
MAX_BOXES = 1000  # Candidates beyond the best 1000 of one image are dropped, so that a bad model can't fill the memory


def windows(size_wh: Size, aspect: float, overlap: float) -> list[Window]:
    """The whole image, and, where its longer side exceeds `aspect` times the shorter one, windows of that aspect.

    Windows lie along the longer side, evenly spread; neighbors overlap by at least the share `overlap`. They are
    longer than `aspect` says where more than `MAX_WINDOWS` were needed otherwise.
    """
    width, height = size_wh
    short, length = min(size_wh), max(size_wh)
    whole = [(0, 0, width, height)]
    longest = math.ceil(length / (1 + (MAX_WINDOWS - 1) * (1 - overlap)))
    side = round(min(length, max(short * aspect, longest)))
    if side == length:
        return whole
    num = min(MAX_WINDOWS, 1 + math.ceil((length - side) / (side * (1 - overlap))))
    starts = [round((length - side) * i / (num - 1)) for i in range(num)]
    if width > height:
        return whole + [(at, 0, at + side, short) for at in starts]
    return whole + [(0, at, short, at + side) for at in starts]


def to_image(boxes: Candidates, window: Window, size_wh: Size, margin_px: float = 3.0) -> Candidates:
    """Move boxes from a window to the image, without those that the window's inner border cuts. A cut box is only a
    part of an object, which a neighboring window or the whole image shows in full.
    """
    left, top, right, bottom = window
    inner = np.array([left > 0, top > 0, right < size_wh[0], bottom < size_wh[1]])
    clipped = boxes.clip((right - left, bottom - top))
    gap = np.abs(clipped.xyxy - np.array([0.0, 0.0, right - left, bottom - top]))
    whole = ~((gap < margin_px) & inner).any(axis=1)
    return clipped[whole].move((1.0, 1.0), (float(left), float(top)))


def merge(parts: list[Candidates], iou: float, containment: float) -> Candidates:
    """Greedy non-maximum suppression: of two rivals of one group the one with the better score stays.

    Rivals overlap by more than `iou`, or one contains more than the share `containment` of the other, which then
    is a part of the same object.

    All vehicles are one group, since one object can come back as bus and as truck; others are groups by label.
    """
    boxes = Candidates.join([*parts, NO_CANDIDATES])
    # Equal scores by box, then label, so that the order is always the same.
    boxes = boxes[np.lexsort((boxes.label, *boxes.xyxy.T[::-1], -boxes.score))[:MAX_BOXES]]
    group = np.where(np.isin(boxes.label, VEHICLES), "vehicle", boxes.label)
    xyxy = boxes.xyxy
    overlap, area = common_areas(xyxy, xyxy), np.prod(xyxy[:, 2:] - xyxy[:, :2], axis=1)
    rivals = (iou_2d(xyxy, xyxy) > iou) | (overlap / np.minimum(area[:, None], area[None, :]) > containment)
    rivals &= group[:, None] == group[None, :]
    return boxes[suppress(rivals)]


CITY_WEIGHTS = Path(__file__).with_name("city.onnx")  # See `docs/detector.md`


@dataclass(frozen=True)
class CameraParams(CheckedParams, prefix="camera"):
    """Parameters of the camera detector."""

    builtin = CITY_WEIGHTS
    channels = RGB  # Of the model's input

    weights: Weights = AUTO
    """An ONNX file, or a name of `fbench weights list`; `auto` is fbench's own on simulated logs, and on others none;
    with `none` the camera isn't used.
    """
    min_score: float | None = in_range(None, 0, 1)
    """Boxes with a lower score are dropped. Unless set, this and the next two are what the weights' metadata say under
    these names, else 0.6, 0.5 and 0.9.
    """
    nms_iou: float | None = in_range(None, 0, 1)
    """Of two boxes of one group that overlap more than this, the one with the higher score stays."""
    nms_containment: float | None = in_range(None, 0, 1)
    """The same for a box of which more than this share lies inside the other."""
    tiles: bool = True
    """Look also at overlapping windows of very wide or tall images, since far objects vanish when these are shrunk."""
    tile_aspect: float = in_range(2.0, 1)
    """Longer by shorter side of such a window; images up to this aspect are looked at as a whole only."""
    tile_overlap: float = in_range(0.1, 0, 0.9)  # Least share of a window by which neighbors overlap.
    input_wh: tuple[int, int] | None = None
    """Width and height of the model's input [px], for models that leave it free."""
    threads: int = in_range(2, 1)
    """Threads of onnxruntime at most, and no more than there are processors; results are the same for any number."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for side in self.input_wh or ():
            require_between(f"{self._prefix}input_wh", side, *SIDE_PX)
        object.__setattr__(self, "weights", resolve(self.weights))


@dataclass(frozen=True, eq=False)
class CameraDetections:
    """N boxes of one image, by falling score."""

    xyxy_px: Float64  # (N, 4) left, top, right, bottom [px]; pixel centers at integers
    score: Float64  # (N,) 0 to 1
    label: Text  # (N,) of `LABELS`
    min_score: float = 0.0
    """Boxes from this score on are reported by a camera alone; those below are for others to confirm."""

    def __post_init__(self) -> None:
        freeze_fields(self, xyxy_px=("f8", ("N", 4)), score=("f8", ("N",)), label=("U", ("N",)))

    def __len__(self) -> int:
        return len(self.score)


@dataclass(frozen=True, eq=False)
class Prepared:
    """An image, cut and scaled for the model."""

    size_wh: Size
    windows: Sequence[Window]
    batches: Sequence[Batch]


Draw: TypeAlias = Callable[[Window, Placement, Size], Pixels]
"""Draws further channels (H, W, C) of a window of the image, placed in an input of this size."""


class CameraDetector:
    """Finds road users with an ONNX model. Raises ConfigError without weights or file, ModelError where unusable."""

    def __init__(self, params: CameraParams) -> None:
        if not isinstance(params.weights, Path):
            raise ConfigError("the camera needs a detector: --set camera.weights=PATH (an ONNX file)")
        self._params = params
        threads = min(params.threads, num_threads())
        self._model = Model(params.weights, threads, params.input_wh, params.channels)
        asked = {f.name: getattr(params, f.name) for f in fields(Thresholds)}
        try:
            self._thresholds = thresholds(asked, self._model.metadata)
        except ModelError as error:
            raise ModelError(f"{params.weights}: {error}") from error

    def prepare(self, pixels: Pixels, draw: Draw | None = None) -> Prepared:
        """Cut and scale an image (H, W, 3) BGR, and draw what else the model looks at."""
        size = (pixels.shape[1], pixels.shape[0])
        wide = self._params.tile_aspect if self._params.tiles else math.inf
        parts = windows(size, wide, self._params.tile_overlap)
        images = [pixels[top:bottom, left:right] for left, top, right, bottom in parts]
        drawn = (
            []
            if draw is None
            else [
                draw(part, *self._model.placement((image.shape[1], image.shape[0])))
                for part, image in zip(parts, images, strict=True)
            ]
        )
        return Prepared(size, parts, self._model.batches(images, drawn))

    def infer(self, prepared: Prepared, share: float = 1.0) -> CameraDetections:
        """Run the model and merge what it found, down to this share of the score from which on boxes are reported.
        Raises ModelError where the model fails, or its outputs aren't as its header says.
        """
        least = share * self._thresholds.min_score
        found = [boxes for batch in prepared.batches for boxes in self._model.run(batch, least)]
        parts = [to_image(*part, prepared.size_wh) for part in zip(found, prepared.windows, strict=True)]
        merged = merge(parts, self._thresholds.nms_iou, self._thresholds.nms_containment)
        return CameraDetections(merged.xyxy - 0.5, merged.score, merged.label, self._thresholds.min_score)


@cache
def require_cuda() -> None:
    """Run a network on a GPU. Raises ConfigError where that can't be done: why, and what to install."""
    try:
        with use_device("cuda"):
            Model(CITY_WEIGHTS, 1, None)
    except ModelError as error:
        raise ConfigError(f"--device cuda: networks can't run on the GPU ({error}); {INSTALL_LIBRARIES}") from error


def use_builtin(own: Mapping[str, CameraParams], log_info: LogInfo) -> dict[str, CameraParams]:
    """Return the parameters of all cameras, with the built-in weights in place of `auto` where the log is simulated."""
    if SIMULATED not in log_info.metadata:
        return dict(own)
    return {
        name: replace(params, weights=params.builtin) if params.weights == AUTO else params
        for name, params in own.items()
    }


def builtin_identity(own: Mapping[str, CameraParams], asked: CameraParams) -> dict[str, object]:
    """Return what the manifest says of built-in weights, where cameras use them."""
    used = [f"{name}." for name, params in own.items() if params.weights == asked.builtin]
    if asked.weights == AUTO:
        used = [asked._prefix] if used else []
    return {f"{name}weights": describe_file(asked.builtin) for name in used if asked.weights != asked.builtin}


def decode_image(image: Image, clock: StageClock, faults: list[Fault]) -> Pixels | None:
    """Decode one image, timed as `decode`; where it is corrupt, append a fault and return `None`."""
    with clock.stage("decode"):
        pixels = decode(image)
    if pixels is None:
        faults.append(Fault("DEC002", f"{image.sensor} at stamp {image.stamp_ns}"))
    return pixels


def look(
    detector: CameraDetector, image: Image, clock: StageClock, faults: list[Fault], share: float = 1.0
) -> CameraDetections | None:
    """Detect road users in one image; where it is corrupt, append a fault and return `None`.

    With a `share` below 1 also those that other sensors may confirm: down to that share of the camera's `min_score`.

    Timed as `decode`, `preprocess` and `detect.camera`. Raises ModelError where the model fails.
    """
    if (pixels := decode_image(image, clock, faults)) is None:
        return None
    with clock.stage("preprocess"):
        prepared = detector.prepare(pixels)
    with clock.stage("detect.camera"):
        return detector.infer(prepared, share)


NO_WEIGHTS = "no weights"  # Why a camera for which no detector is named isn't used


class CameraStage:
    """Loads the weights that parameters name, once for all logs; those of the kind at once.

    With a `share` below 1 boxes down to that share of a camera's `min_score` are found, for other sensors to confirm.
    Raises ConfigError where the file with the weights is missing. Raises ModelError where the weights can't be used.
    """

    def __init__(self, params: CameraParams, share: float = 1.0) -> None:
        self._params, self._share, self._loaded = params, share, dict[CameraParams, CameraDetector]()
        self._load(params)
        self.used: Mapping[str, CameraDetector] = {}  # Detectors of the cameras that have weights, by their names
        self.missing: Mapping[str, str] = {}  # The other cameras of the rig, with the reason
        self.identity: Mapping[str, object] = {}  # Which weights are used, where no parameter names them

    def start(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig, each with its own parameters; see the class for what is raised. On simulated
        logs `auto` is the built-in detector.
        """
        own = use_builtin(settings.own("camera", self._params), log_info)
        found = {name: self._load(params) for name, params in own.items()}
        self._rig, self.identity, cameras = rig, builtin_identity(own, self._params), rig.sensors("camera")
        self.used = {name: detector for name in cameras if (detector := found.get(name)) is not None}
        self.missing = {name: NO_WEIGHTS for name in cameras if name not in self.used}

    def _load(self, params: CameraParams) -> CameraDetector | None:
        if not isinstance(params.weights, Path):
            return None
        if params not in self._loaded:
            self._loaded[params] = CameraDetector(params)
        return self._loaded[params]

    def require_projections(self) -> None:
        """Refuse used cameras without a projection. Raises LogError naming the first one, and why."""
        for name in self.used:
            require_projection(self._rig, name)

    def view(self, frame: Frame, clock: StageClock, faults: list[Fault]) -> dict[str, CameraDetections]:
        """Detect in the images of one frame, by camera in the order of their names.

        Cameras without an image in the frame are left out; so are those whose image is corrupt, which is a fault. Timed
        as `decode`, `preprocess` and `detect.camera`. Raises ModelError where a model fails.
        """
        found = dict[str, CameraDetections]()
        for name, detector in self.used.items():
            if isinstance(image := frame.messages.get(name), Image):
                seen = look(detector, image, clock, faults, self._share)
                if seen is not None:
                    found[name] = seen
        return found
