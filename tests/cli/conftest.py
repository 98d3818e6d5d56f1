"""The command line in this process, and small logs."""

import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from types import SimpleNamespace

import numpy as np
import pytest

from fbench.api.verify_child import run
from fbench.cli import main
from fbench.replay.check.difference import TASK
from fbench.replay.check.verify import variants
from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, RadarScan, Truth
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig
from fbench.replay.logs.containers.mcap.write import McapWriter

MS = 1_000_000
UPRIGHT = np.array([0.0, 0, 0, 1])
FORWARD = np.array([-0.5, 0.5, -0.5, 0.5])


@dataclass(frozen=True)
class Result:
    code: int
    out: str
    err: str

    def json(self):
        return json.loads(self.out)


@pytest.fixture
def fbench(monkeypatch, capsys, tmp_path):
    """Call `fbench ARGS` in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*args):
        monkeypatch.setattr(sys, "argv", ["fbench", *map(str, args)])
        code = 0
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return Result(code, captured.out, captured.err)

    return call


@pytest.fixture
def circumstances(monkeypatch):
    """Let `fbench verify` try only those whose names begin so, each of which costs a process."""

    def choose(*names):
        def chosen(num_repeats, span_s, quick):
            return tuple(v for v in variants(num_repeats, span_s, quick=False) if v.name.startswith(names))

        monkeypatch.setattr("fbench.replay.check.verify.variants", chosen)

    return choose


@pytest.fixture
def in_this_process(monkeypatch):
    """Let `fbench verify` replay the circumstances whose folders' names begin so (none given: all) in this process:
    where no process is the point, each costs seconds. `test_verify` tries those that are.
    """
    one_at_a_time = Lock()

    class Popen:
        """Begins only when it is given a task, which says where it runs."""

        names = ("",)

        def __init__(self, *args, **kwargs):
            self._begin, self.returncode = (lambda: subprocess.Popen(*args, **kwargs)), None

        def communicate(self, text):
            task = TASK.validate_python(json.loads(text))
            if not task.folder.name.startswith(self.names):
                process = self._begin()
                said = process.communicate(text)
                self.returncode = process.returncode
                return said
            with one_at_a_time:
                try:
                    run(task)
                except FbenchError as error:
                    self.returncode = error.exit_code
                    return f"{error.line}\n", ""
            self.returncode = 0
            return "", ""

        def poll(self):
            return self.returncode

        def kill(self):
            pass

    def choose(*names):
        Popen.names = names or ("",)
        stand_in = SimpleNamespace(Popen=Popen, PIPE=subprocess.PIPE)
        monkeypatch.setattr("fbench.replay.check.verify.subprocess", stand_in)

    return choose


def car_points(x, y=0.0):
    """LiDAR points on the back and one side of a car, and a ring of ground."""
    side = [(x + u, y + 0.9, z) for u in np.linspace(-2, 2, 20) for z in (0.4, 0.8, 1.2)]
    back = [(x - 2, y + v, z) for v in np.linspace(-0.9, 0.9, 10) for z in (0.4, 0.8, 1.2)]
    ground = [(r * np.cos(a), r * np.sin(a), 0.0) for r in range(4, 40, 3) for a in np.linspace(-1, 1, 40)]
    return np.array([*side, *back, *ground], np.float32)


def rig(camera=True):
    mounts = {"lidar": Mount("lidar", np.zeros(3), UPRIGHT), "radar": Mount("radar", np.zeros(3), UPRIGHT)}
    if not camera:
        return Rig(mounts, {})
    model = CameraModel(np.array([[60.0, 0, 39.5], [0, 60, 29.5], [0, 0, 1]]), (80, 60))
    return Rig({**mounts, "camera": Mount("camera", np.array([0, 0, 1.0]), FORWARD)}, {"camera": model})


def messages(num_frames=6, camera=True):
    for i in range(num_frames):
        stamp = 1_000_000_000 + 100 * MS * i
        x = 12.0 + i
        if camera:
            yield Image("camera", stamp, stamp, encode_jpeg(np.full((60, 80, 3), 90, np.uint8)), "jpeg", (80, 60))
        yield PointCloud("lidar", stamp, stamp + 1 * MS, car_points(x))
        points = np.array([[x - 2, v, 0.5] for v in (-0.5, -0.2, 0.2, 0.5)], np.float32)
        yield RadarScan(
            "radar", stamp, stamp + 2 * MS, points, np.full(4, 10.0, np.float32), np.full(4, 15.0, np.float32)
        )


def truths(num_frames=6):
    for i in range(num_frames):
        stamp = 1_000_000_000 + 100 * MS * i
        box = Boxes3D(
            np.array([[12.0 + i, 0, 0.75]]),
            np.array([[4.0, 1.8, 1.5]]),
            np.zeros(1),
            label=np.array(["car"]),
            track_id=np.array([3]),
        )
        yield Truth(stamp, stamp, box)


def write_log(path: Path, items, log_rig=None, metadata=None) -> Path:
    with McapWriter(path, LogInfo(path.stem, "test-1", metadata or {}), log_rig or rig()) as writer:
        for item in sorted(items, key=lambda m: m.log_ns):
            writer.write(item)
    return path


@pytest.fixture(scope="session")
def car_log(tmp_path_factory):
    """Content of the log of `log`."""
    return write_log(tmp_path_factory.mktemp("car") / "car.mcap", [*messages(), *truths()]).read_bytes()


@pytest.fixture
def log(tmp_path, car_log):
    """Six frames of camera, LiDAR, radar and truth: a car drives away at 10 m/s."""
    path = tmp_path / "car.mcap"
    path.write_bytes(car_log)
    return path
