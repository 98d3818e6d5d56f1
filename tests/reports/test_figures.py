"""Figures for papers: what is drawn, and that equal runs give equal bytes."""

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from tests.reports.conftest import Plan, score
from tests.reports.test_safety import hostile_plan

from fbench.replay.contracts.errors import ConfigError, MissingPackageError
from fbench.replay.runs.folder import Run
from fbench.reports import figures
from fbench.reports.figures import Curve, draw_runs, draw_suite

MakeRun = Callable[[Plan], Run]
CURVE = Curve(np.array([0.2, 0.5, 0.5]), np.array([1.0, 1.0, 0.8]))
SCORES = [
    replace(score("f1", 0.5), low=0.4, high=0.625, interval="95 %"), score("f1", 0.25, class_="pedestrian"),
    replace(score("f1", 0.75), slice="range 0-10 m"), replace(score("f1", 0.375), slice="range 10-20 m"),
    score("f1", 0.9, matching="iou 0.5"), score("f1", None, "no truth boxes", class_="bus"),
]  # fmt: skip


@pytest.fixture
def drawn(monkeypatch):
    """Figures by name, as they are when they are saved."""
    found = {}
    save = figures._save

    def keep(path, draw):
        def remember(figure):
            draw(figure)
            found[path.name] = figure

        return save(path, remember)

    monkeypatch.setattr(figures, "_save", keep)
    return found


def test_figures_show_the_numbers(make_run: MakeRun, tmp_path: Path, drawn) -> None:
    runs = [make_run(Plan(scores=SCORES)), make_run(Plan(name="b", pipeline="lidar3d", scores=SCORES[:1]))]
    paths = draw_runs(runs, [CURVE, None], tmp_path / "f")
    names = {path.relative_to(tmp_path / "f").as_posix() for path in paths}
    drawings = ("f1_by_class", "f1_by_distance", "precision_recall", "timing/latency")
    assert names == {f"{name}.{form}" for name in drawings for form in ("svg", "png")}
    lines = [line.get_ydata() for line in drawn["f1_by_class"].axes[0].lines]
    assert [list(line) for line in lines] == [[0.5, 0.25], [0.4, 0.625], [0.5], [0.4, 0.625]]
    assert [text.get_text() for text in drawn["f1_by_class"].axes[0].get_xticklabels()] == ["vehicle", "pedestrian"]
    assert list(drawn["f1_by_distance"].axes[0].lines[0].get_ydata()) == [0.75, 0.375]
    assert list(drawn["precision_recall"].axes[0].lines[0].get_xdata()) == [0.2, 0.5, 0.5]
    bars = drawn["latency"].axes[0].patches
    assert [(bar.get_x(), bar.get_width()) for bar in bars] == [(0, 12), (0, 12), (0, 82), (0, 82)]
    for path in paths:
        if path.suffix == ".png":
            assert cv2.imread(str(path)).shape == (480, 700, 3)
        else:
            assert ElementTree.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"  # noqa: S314


def test_equal_runs_give_equal_bytes(make_run: MakeRun, tmp_path: Path, monkeypatch) -> None:
    run = make_run(Plan(scores=SCORES))
    first = draw_runs([run], [CURVE], tmp_path / "a")
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "86400")
    second = draw_runs([run], [CURVE], tmp_path / "b")
    assert [path.read_bytes() for path in first] == [path.read_bytes() for path in second]
    assert not [path for path in first if b"<dc:date" in path.read_bytes()]


def results(folder: Path, *rows: tuple[str, str, float | None, float | None, float | None]) -> Path:
    keys = ("name", "column", "value", "low", "high")
    path = folder / "results.json"
    path.write_text(json.dumps({"tables": {"severity_curves": [dict(zip(keys, row, strict=True)) for row in rows]}}))
    return path


def test_robustness_is_drawn_over_severity_by_condition(tmp_path: Path, drawn) -> None:
    path = results(
        tmp_path, ("fog clear", "late3d", 0.9, 0.85, 0.95), ("fog 1", "late3d", 0.8, 0.7, 0.9),
        ("fog 3", "late3d", 0.5, 0.4, 0.6), ("fog 5", "late3d", None, None, None),
        ("dropout.radar clear", "late3d", 0.7, None, None),
        ("dropout.radar 2", "late3d", 0.6, None, None), ("fog 3", "lidar3d", 0.3, None, None),
    )  # fmt: skip
    draw_suite(path, tmp_path / "f")
    fog, radar = drawn["robustness"].axes
    assert (fog.get_title(), radar.get_title()) == ("fog", "dropout.radar")
    assert list(radar.lines[0].get_ydata()) == [0.7, 0.6]
    assert [(list(line.get_xdata()), list(line.get_ydata())) for line in fog.lines] == [
        ([0, 1, 3], [0.9, 0.8, 0.5]), ([3], [0.3]),
    ]  # fmt: skip
    assert [text.get_text() for text in fog.get_legend().get_texts()] == ["late3d", "lidar3d"]


def test_nothing_to_draw_is_an_error(make_run: MakeRun, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="nothing to draw"):
        draw_runs([make_run(Plan(scores=None, latency=None))], [None], tmp_path / "f")
    with pytest.raises(ConfigError, match="nothing to draw"):
        draw_suite(results(tmp_path), tmp_path / "f")
    assert not (tmp_path / "f").exists()


def test_matplotlib_is_asked_for_only_here(make_run: MakeRun, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match=r"pip install 'fbench\[figures\]'"):
        draw_runs([make_run(Plan())], [None], tmp_path / "f")


def test_hostile_text_is_drawn_and_does_nothing(make_run: MakeRun, tmp_path: Path) -> None:
    plan = hostile_plan()
    formula = r"$\frac{$ {\input{/etc/passwd}} </svg><script>alert(1)</script> --> \x1b[31m \u202e"
    plan = replace(
        plan, pipeline=formula, scores=[score("f1", 0.5, class_=plan.pipeline), score("f1", 0.25, class_=formula)]
    )
    paths = draw_runs([make_run(plan), make_run(replace(plan, name="b"))], [CURVE, CURVE], tmp_path / "f")
    for path in paths:
        if path.suffix == ".svg":
            elements = [element.tag.rpartition("}")[2] for element in ElementTree.parse(path).iter()]  # noqa: S314
            assert not {"script", "image", "a", "foreignObject"} & set(elements)
            assert not [a for e in ElementTree.parse(path).iter() for a in e.attrib if a.startswith("on")]  # noqa: S314
            content = path.read_text("utf-8")
            assert all(c.isprintable() or c == "\n" for c in content)
