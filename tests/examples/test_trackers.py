"""Scripts that hand results to other programs, against stand-ins: the programs themselves are too heavy for tests."""

import runpy
import sys
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from tests.reports.conftest import Plan, boxes2d, make_run

from fbench.replay.runs.folder import Run

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
__all__ = ["make_run"]


class Recorder(SimpleNamespace):
    """Notes what it is called with."""

    def __init__(self) -> None:
        super().__init__(calls=[])

    def note(self, name: str) -> Callable[..., Any]:
        def call(*args: Any, **kwargs: Any) -> Any:
            self.calls.append((name, args, kwargs))
            return SimpleNamespace(log=self.note("log"), save=self.note("save"))

        return call

    def opening(self, name: str) -> Callable[..., Any]:
        @contextmanager
        def call(**kwargs: Any) -> Any:
            yield self.note(name)(**kwargs)

        return call


def run_script(name: str, module: Any, monkeypatch: pytest.MonkeyPatch, *args: object) -> None:
    monkeypatch.setitem(sys.modules, name.split("_")[0], module)
    monkeypatch.setattr(sys, "argv", [name, *map(str, args)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")


def test_mlflow(make_run: Callable[[Plan], Run], monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = make_run(Plan()), Recorder()
    names = ("log_params", "log_metrics", "log_artifact")
    module = SimpleNamespace(start_run=seen.opening("start_run"), **{name: seen.note(name) for name in names})
    run_script("mlflow_log.py", module, monkeypatch, run.folder)
    calls = {name: (args, kwargs) for name, args, kwargs in seen.calls}
    assert calls["start_run"][1] == {"run_name": "street late3d"}
    assert calls["log_metrics"][0][0]["idsw/vehicle"] == 3.0
    assert calls["log_metrics"][0][0]["f1/pedestrian"] == 0.25
    assert "mota/vehicle" not in calls["log_metrics"][0][0]  # it has no value
    assert Path(calls["log_artifact"][0][0]).name == "scores.json"


def test_wandb(make_run: Callable[[Plan], Run], monkeypatch: pytest.MonkeyPatch) -> None:
    run, seen = make_run(Plan()), Recorder()
    run_script("wandb_log.py", SimpleNamespace(init=seen.opening("init")), monkeypatch, run.folder)
    calls = {name: (args, kwargs) for name, args, kwargs in seen.calls}
    assert calls["init"][1]["config"]["pipeline"] == "late3d"
    assert calls["log"][0][0]["motp/vehicle"] == 0.25
    assert "save" in calls


def test_fiftyone(make_run: Callable[[Plan], Run], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    class Sample(dict[str, Any]):
        def __init__(self, filepath: str, tags: list[str]) -> None:
            super().__init__(filepath=filepath, tags=tags)

    samples: list[Sample] = []
    module = SimpleNamespace(
        Dataset=lambda name, overwrite: SimpleNamespace(add_sample=samples.append), Sample=Sample,
        Detection=lambda **what: what, Detections=lambda detections: detections,
    )  # fmt: skip
    run = make_run(Plan(make_boxes=boxes2d))
    run_script("fiftyone_export.py", module, monkeypatch, run.folder, tmp_path / "images")
    assert [Path(sample["filepath"]).name for sample in samples] == ["0-cam.jpg", "2-cam.jpg"]
    assert Path(samples[0]["filepath"]).read_bytes() == run.media[0].pictures["cam"].jpeg
    (found,) = samples[0]["detections"]
    assert found == {"label": "car", "confidence": 0.5, "bounding_box": [10.5 / 160, 20.5 / 120, 0.25, 40 / 120]}
