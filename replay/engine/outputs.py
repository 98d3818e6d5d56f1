"""Checks of what a pipeline returns, before anything of it is recorded."""

from collections.abc import Mapping
from typing import get_args

import numpy as np

from fbench.replay.contracts.errors import DataError, did_you_mean
from fbench.replay.contracts.faults import FAULTS
from fbench.replay.data.boxes import LABELS, Boxes, Boxes2D, Boxes3D
from fbench.replay.data.frames import ClockName, Fault, Output
from fbench.replay.data.rig import Rig


class OutputCheck:
    """Checks outputs of one run: their types, names that exist, and one kind of boxes throughout."""

    def __init__(self, rig: Rig) -> None:
        self._cameras = tuple(sorted(rig.cameras))
        self._kind: type[Boxes] | None = None

    def __call__(self, output: object) -> Output:
        """Return the output as it is.

        Raises:
            DataError: saying what is wrong.
        """
        if not isinstance(output, Output):
            raise DataError(f"step() gave {type(output).__name__}, expected Output")
        for name, boxes in (("detections", output.detections), ("tracks", output.tracks)):
            self._check_boxes(name, boxes)
        self._kind = type(output.detections)
        _check_texts("missing", dict(output.missing))
        _check_times(dict(output.stage_ns))
        if output.clock not in get_args(ClockName):
            raise DataError(f"Output.clock: expected {' or '.join(get_args(ClockName))}, got {output.clock!r}")
        for fault in output.faults:
            if not isinstance(fault, Fault) or fault.code not in FAULTS:
                raise DataError(f"Output.faults: {fault!r} isn't a fault of the table")
        return output

    def _check_boxes(self, name: str, boxes: object) -> None:
        if not isinstance(boxes, Boxes2D | Boxes3D):
            raise DataError(f"Output.{name}: expected Boxes2D or Boxes3D, got {type(boxes).__name__}")
        if self._kind is not None and type(boxes) is not self._kind:
            raise DataError(
                f"Output.{name}: expected {self._kind.__name__} as in other frames, got {type(boxes).__name__}"
            )
        if boxes.label is not None:
            _check_names(f"Output.{name}.label", boxes.label.tolist(), ("", *LABELS))
        if isinstance(boxes, Boxes2D):
            _check_names(f"Output.{name}.camera", boxes.camera.tolist(), self._cameras)


def _check_names(where: str, names: list[str], known: tuple[str, ...]) -> None:
    for name in names:
        if name not in known:
            raise DataError(f"{where}: '{name}' isn't known{did_you_mean(name, known)}")


def _check_texts(where: str, texts: Mapping[str, object]) -> None:
    for key, value in texts.items():
        if not isinstance(key, str) or not isinstance(value, str):
            raise DataError(f"Output.{where}: expected texts, got {key!r}: {value!r}")


def _check_times(stage_ns: Mapping[str, object]) -> None:
    for stage, ns in stage_ns.items():
        if not isinstance(stage, str) or not isinstance(ns, int | np.integer) or ns < 0:
            raise DataError(f"Output.stage_ns: expected names and times [ns], got {stage!r}: {ns!r}")
