"""Poses of a sequence of the tracking benchmark: `oxts/0000.txt`, a row a frame."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

from fbench.datasets.kitti.files import bounded_lines
from fbench.datasets.kitti.oxts import Fix, World, fix_of
from fbench.datasets.kitti.rig import Calibration
from fbench.replay.data import Pose
from fbench.replay.errors import LogError
from fbench.replay.imports.wish import BadInput


class SequencePoses:
    """Poses by frame; there are none without a file, or where the calibration doesn't tell where the IMU is."""

    def __init__(self, path: Path, bad: BadInput) -> None:
        self.path, self._bad = path, bad

    @cached_property
    def _fixes(self) -> Mapping[int, Fix]:
        """Of all frames, as the first one is the origin of the world."""
        return dict(self._read()) if self.path.is_file() else {}

    def _read(self) -> Iterator[tuple[int, Fix]]:
        for line in bounded_lines(self.path):
            try:
                yield line.number - 1, fix_of(" ".join(line.fields), line.where)
            except LogError as error:
                self._bad.met(error)

    @cached_property
    def _world(self) -> World | None:
        first = next(iter(self._fixes.values()), None)
        return None if first is None else World(first)

    def pose(self, number: int, calibration: Calibration, stamp_ns: int) -> Pose | None:
        """The body's pose at a frame, where it is known."""
        if self._world is None or number not in self._fixes:
            return None
        return self._world.body_pose(self._fixes[number], calibration, stamp_ns, number)

    def metadata(self, calibration: Calibration) -> Mapping[str, str]:
        """Where the origin of the world is."""
        return {} if self._world is None or calibration.body_T_imu is None else self._world.metadata()

    def notes(self, calibration: Calibration, num_frames: int) -> Iterator[str]:
        """Lines for the summary."""
        if not self._fixes:
            yield "poses: none"
        elif calibration.body_T_imu is None:
            yield "poses: left out, as the calibration doesn't tell where the IMU is"
        else:
            last = max(self._fixes) + 1
            odd = "" if last == num_frames else f", though the sequence has {num_frames} frames"
            yield f"poses: of frames 0 to {last - 1}{odd}"
