"""A dataset for tests: a folder a sequence, a file of float32 points (N, 3) a sweep, named by its number.

A file `calibration` may hold bytes that make the whole sequence unusable, and one called `signal` a number: that signal
comes when its sequence is half imported.
"""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from fbench.datasets.importing.files import read_floats
from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import ImportRequest, file_facts, log_id, require_folder
from fbench.replay.data.messages import PointCloud
from fbench.replay.data.rig import LogInfo, Mount, Rig


@dataclass(frozen=True)
class ToyParams:
    """Parameters of `Toy`."""

    scale: float = 1.0
    """What coordinates are multiplied by."""


class Toy:
    def __init__(self, params: ToyParams = ToyParams()) -> None:
        self._params = params

    def names(self, source: Path) -> Sequence[str]:
        require_folder(source)
        return sorted(path.name for path in source.iterdir() if path.is_dir())

    def recordings(self, source: Path, asked: ImportRequest) -> Iterator["ToyRecording"]:
        for name in asked.names:
            yield ToyRecording(name, source / name, asked, self._params)


class ToyRecording:
    def __init__(self, name: str, folder: Path, asked: ImportRequest, params: ToyParams) -> None:
        self.name, self._folder, self._asked, self._params = name, folder, asked, params
        self._num = 0

    @cached_property
    def _paths(self) -> list[Path]:
        return [path for path in sorted(self._folder.glob("*.bin")) if int(path.stem) in self._asked.frames]

    @property
    def info(self) -> LogInfo:
        facts = file_facts(self._folder, self._paths)
        id_ = log_id("toy", [self.name, *facts], self._asked.frames, self._params)
        return LogInfo(self.name, id_, {"dataset": "toy", "licence": "none"})

    @property
    def rig(self) -> Rig:
        if (self._folder / "calibration").exists():
            raise LogError(f"{self._folder / 'calibration'}: can't be understood")
        return Rig({"lidar": Mount("lidar", np.zeros(3), np.array([0.0, 0, 0, 1]))}, {})

    @property
    def num_items(self) -> int:
        return len(self._paths)

    def items(self) -> Iterator[PointCloud]:
        for i, path in enumerate(self._paths):
            if i == len(self._paths) // 2 and (self._folder / "signal").exists():
                os.kill(os.getpid(), int((self._folder / "signal").read_text()))
            try:
                xyz = read_floats(path, 3) * np.float32(self._params.scale)
            except LogError as error:
                self._asked.bad.report(error)
                continue
            stamp_ns = 1_000_000_000 + int(path.stem) * 100_000_000
            self._num += 1
            yield PointCloud("lidar", stamp_ns, stamp_ns, xyz, frame_number=int(path.stem))

    def summary(self) -> Sequence[str]:
        return [f"sweeps: {self._num}", "stamps: invented at 10 Hz"]


def write_toy(source: Path, names: Sequence[str], num_sweeps: int = 4, num_points: int = 100) -> Path:
    """Write a dataset of sequences which all differ, and return its folder."""
    for i, name in enumerate(names):
        folder = source / name
        folder.mkdir(parents=True)
        rng = np.random.Generator(np.random.Philox(i))
        for k in range(num_sweeps):
            xyz = rng.uniform(-50, 50, (num_points, 3)).astype(np.float32)
            (folder / f"{k:03d}.bin").write_bytes(xyz.tobytes())
    return source
