"""Plug-ins: built-ins by name, outsiders from a single file."""

import textwrap

import pytest
from tests.replay.fakes import drive

from fbench.replay.contracts.entry_points import entry_points_of, load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import make_pipeline
from fbench.replay.engine.loop import replay
from fbench.replay.engine.plan import Plan
from fbench.replay.runs.folder import Run

OUTSIDER = '''
from dataclasses import dataclass
import numpy as np
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig

@dataclass(frozen=True)
class NearestParams:
    num: int = 1

class Nearest:
    """A box at the nearest LiDAR points."""

    def __init__(self, params: NearestParams = NearestParams()) -> None:
        self.params = params

    def start(self, rig: Rig, log_info: LogInfo) -> None: ...

    def reset(self, reason: str) -> None: ...

    def step(self, frame: Frame) -> Output:
        xyz = np.sort(frame.messages["lidar"].xyz.astype(float), axis=0)[: self.params.num]
        boxes = Boxes3D(xyz, np.ones((len(xyz), 3)), np.zeros(len(xyz)))
        return Output(boxes, boxes, {})

class Plain(Nearest):
    def __init__(self) -> None:
        super().__init__()

class Loose(Nearest):
    def __init__(self, params) -> None:
        super().__init__()

class Odd:
    pass
'''


@pytest.fixture
def outsider(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(textwrap.dedent(OUTSIDER))
    return path


def test_builtins_come_in_by_entry_points():
    assert {"camera2d", "lidar3d", "radar3d", "late3d"} <= set(entry_points_of("pipelines"))
    assert "astyx" in entry_points_of("datasets")
    assert "html" in entry_points_of("reports")
    assert {"detection", "tracking"} <= set(entry_points_of("metrics"))
    for group in ("datasets", "pipelines", "metrics", "reports"):
        for name in entry_points_of(group):
            assert load(group, name).__doc__


def test_unknown_names_get_the_nearest_one():
    with pytest.raises(ConfigError, match="unknown pipeline 'late3'; did you mean 'late3d'"):
        load("pipelines", "late3")
    with pytest.raises(ConfigError, match="unknown dataset 'xyz'; there are: astyx"):
        load("datasets", "xyz")


def test_pipeline_in_a_single_file_runs(outsider, tmp_path):
    pipeline, parameters = make_pipeline(f"{outsider}:Nearest", ["num=2"])
    assert parameters == {"num": 2}
    run = Run(replay(drive(3), Plan(pipeline, "nearest", parameters), tmp_path / "run", FaultLog()))
    assert run.detections.at(1).center_m.tolist() == [[11, 0, 0], [12, 0, 0]]
    assert run.manifest.parameters == {"num": 2}


def test_pipeline_without_parameters(outsider):
    assert make_pipeline(f"{outsider}:Plain", [])[1] == {}
    with pytest.raises(ConfigError, match="takes no parameters, so --set num=1 can't be applied"):
        make_pipeline(f"{outsider}:Plain", ["num=1"])


@pytest.mark.parametrize(
    ("cls", "message"),
    [
        ("Neerest", "has no class 'Neerest'; did you mean 'Nearest'"),
        ("Odd", r"isn't one: it lacks start\(\), reset\(\), step\(\)"),
        ("Loose", "its argument 'params' must be annotated with a dataclass"),
        ("np", "has no class 'np'"),
    ],
)
def test_wrong_classes(outsider, cls, message):
    with pytest.raises(ConfigError, match=message):
        make_pipeline(f"{outsider}:{cls}", [])


def test_files_that_cannot_be_loaded(tmp_path):
    with pytest.raises(ConfigError, match=r"absent.py: no such file"):
        make_pipeline(f"{tmp_path}/absent.py:A", [])
    broken = tmp_path / "broken.py"
    broken.write_text("import nothing_of_that_name")
    with pytest.raises(ConfigError, match=r"broken.py: can't be imported: ModuleNotFoundError"):
        make_pipeline(f"{broken}:A", [])
    broken.write_text("def (")
    with pytest.raises(ConfigError, match="SyntaxError"):
        make_pipeline(f"{broken}:A", [])
