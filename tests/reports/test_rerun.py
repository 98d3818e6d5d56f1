"""Rerun recordings, read back by Rerun's own reader."""

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from tests.reports.conftest import Plan, boxes2d
from tests.reports.test_safety import hostile_plan

from fbench.api import reports
from fbench.replay.contracts.errors import ConfigError, MissingPackageError
from fbench.replay.runs.folder import Run
from fbench.replay.runs.outcomes import save_outcomes
from fbench.reports.rerun_recording import write_recording

MakeRun = Callable[[Plan], Run]
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None, reason="rerun-sdk (extra rerun) isn't installed"
)


def read(path: Path) -> dict[str, dict[str, list[Any]]]:
    """Columns of a recording by entity."""
    from rerun.chunk import RrdReader

    found: dict[str, dict[str, list[Any]]] = {}
    for chunk in RrdReader(str(path)).stream():
        own = found.setdefault(chunk.entity_path, {})
        for name, values in chunk.to_record_batch().to_pydict().items():
            own.setdefault(name, []).extend(values)
    return found


@pytest.mark.slow
@needs_rerun
def test_recording_holds_the_run(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Plan())
    save_outcomes(run.folder, {"detections": {(0, ""): "hit", (1, ""): "false alarm"}})
    content = read(write_recording(run, tmp_path / "run.rrd"))
    names = content["/world/body/detections/names"]
    assert names["frame"] == [0, 1, 2, 3]
    assert [pd.Timestamp(stamp).value for stamp in names["stamp"]] == [frame.stamp_ns for frame in run.frames]
    assert names["Points3D:labels"][0] == ["car #7 10.0 m 5.0 m/s LR 0.88"]
    assert names["Points3D:positions"][0] == [[10, 0, 0]]
    hit, alarm = (colors[0] for colors in names["Points3D:colors"][:2])
    assert hit != alarm
    (edges,) = {len(strips) for strips in content["/world/body/tracks"]["LineStrips3D:strips"]}
    assert edges == 12
    assert content["/world/body/top"]["Points3D:positions"][0] == [[1, -2, 0.5], [30, 4, 1]]
    picture = bytes(content["/world/body/cam"]["EncodedImage:blob"][0][0])
    assert picture == run.media[0].pictures["cam"].jpeg


@pytest.mark.slow
@needs_rerun
def test_rectangles_are_in_pixels_of_the_picture(make_run: MakeRun, tmp_path: Path) -> None:
    run = make_run(Plan(make_boxes=boxes2d))
    content = read(write_recording(run, tmp_path / "run.rrd"))
    # Left, top, right, bottom 10, 20, 50, 60 of 160 x 120; the picture has half of both.
    flat = content["/world/body/cam/detections"]
    assert flat["Boxes2D:centers"][0] == [[15.25, 20.25]]
    assert flat["Boxes2D:half_sizes"][0] == [[10, 10]]


@pytest.mark.slow
@needs_rerun
def test_hostile_names_are_shown(make_run: MakeRun, tmp_path: Path) -> None:
    content = read(write_recording(make_run(hostile_plan()), tmp_path / "run.rrd"))
    (text,) = content["/world/body/tracks/names"]["Points3D:labels"][0]
    assert text.startswith("</script><img src=x onerror=alert(1)>")
    assert "\u2028" not in text


def test_without_the_package(make_run: MakeRun, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = make_run(Plan())
    monkeypatch.setitem(sys.modules, "rerun", None)
    for act in (lambda: write_recording(run, tmp_path / "run.rrd"), lambda: reports.show_in_rerun(run.folder)):
        with pytest.raises(MissingPackageError, match=r"fbench\[rerun\]"):
            act()
    with pytest.raises(ConfigError, match=r"ends in \.rrd"):
        write_recording(run, tmp_path / "run.mcap")
    assert not (tmp_path / "run.rrd").exists()


def test_view_opens_the_viewer(make_run: MakeRun, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[list[str]] = []
    run = make_run(Plan())

    def write(given: Run, out: Path) -> Path:
        assert given.folder == run.folder
        out.write_bytes(b"RRF2")
        return out

    def start(command: list[str], check: bool) -> None:
        assert not check
        assert Path(command[-1]).read_bytes() == b"RRF2"
        opened.append(command)

    monkeypatch.setattr("fbench.reports.rerun_recording.write_recording", write)
    monkeypatch.setattr("fbench.reports.rerun_recording.import_rerun", lambda: None)
    monkeypatch.setattr("fbench.api.reports.subprocess.run", start)
    reports.show_in_rerun(run.folder)
    assert [command[1:3] for command in opened] == [["-m", "rerun"]]
    assert not Path(opened[0][-1]).exists()
