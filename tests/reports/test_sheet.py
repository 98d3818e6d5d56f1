"""Contact sheets: what is drawn in which cell, in which color."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from tests.reports.conftest import Plan, boxes2d

from fbench.api.reports import figures, is_suite, render, tables
from fbench.api.runs import report
from fbench.api.sheets import SheetRequest, sheet
from fbench.replay.contracts.errors import ConfigError, MissingPackageError
from fbench.replay.data.boxes import Source
from fbench.replay.runs.manifest import ConditionEntry
from fbench.reports import sheet as drawing


@pytest.fixture
def drawn(monkeypatch):
    """The figure of the last sheet."""
    found = []
    draw = drawing._draw

    def remember(own, figure):
        draw(own, figure)
        found.append(figure)

    monkeypatch.setattr(drawing, "_draw", remember)
    return found


def condition(name, **more):
    return {"scenario": "urban", "seed": "7", "condition": name, **more}


def test_cells_are_pipelines_by_conditions(make_run, tmp_path, drawn):
    plans = [
        Plan("a", pipeline="late3d", metadata=condition("night")),
        Plan("b", pipeline="late3d", metadata=condition("clear")),
        Plan("c", pipeline="camera2d", metadata=condition("clear"), make_boxes=boxes2d),
        Plan("d", pipeline="late3d", metadata=condition("clear", seed="8")),  # another scene, with fewer runs
    ]
    summary = sheet(SheetRequest([make_run(plan).folder for plan in plans], tmp_path / "s.svg", frame=2))
    assert (summary.scene, summary.num_rows, summary.num_columns, summary.notes) == ("urban-7", 2, 2, ())
    axes = drawn[0].axes
    assert [one.get_title() for one in axes] == ["clear", "night", "", ""]
    assert [one.get_ylabel() for one in axes] == ["late3d", "", "camera2d", ""]
    assert [[text.get_text() for text in one.texts] for one in axes] == [
        ["1 found, 1 true"], ["1 found, 1 true"], ["1 found, 1 true"], ["no run"],
    ]  # fmt: skip
    assert [text.get_text() for text in drawn[0].legends[0].get_texts()] == ["C", "L+R", "truth"]


def texts(figure):
    """Titles of the columns, names of the rows, and what stands in cells without a frame."""
    said = [text.get_text() for one in figure.axes for text in one.texts]
    return ([one.get_title() for one in figure.axes if one.get_title()],
            [one.get_ylabel() for one in figure.axes if one.get_ylabel()],
            [text for text in said if text.startswith("no ")])  # fmt: skip


LOST = [ConditionEntry(name="loss", version=1, strength="100%", level={}, sensors="camera")]


@pytest.fixture
def suite(make_run, tmp_path):
    """Two pipelines of one base under two conditions, and the beginning of a drive, once more and disturbed."""
    cells = []
    for log, name, more in [
        ("u-clear", "clear", {}), ("u-fog", "fog", {}), ("u-clear-2s", "clear", {"excerpt": "to 2s", "num_frames": 2}),
        ("u-clear-lost-2s", "clear", {"excerpt": "to 2s", "num_frames": 2, "conditions": LOST}),
    ]:  # fmt: skip
        for row in ("early3d", "early3d-stereo"):
            make_run(Plan(f"suite/{log}/{row}", "street", "early3d", metadata=condition(name), first_truth=2, **more))
            cells.append({"log": log, "pipeline": f"my-{row}", "condition": "clear", "rate": "max", "seed": 0,
                          "state": "replayed", "reason": "", "run": f"{log}/{row}"})  # fmt: skip
    (tmp_path / "suite/results.json").write_text("{}")
    return tmp_path / "suite", pa.Table.from_pylist(cells)


def test_a_suite_has_a_row_for_each_of_its_pipelines_and_no_parts_of_logs(suite, tmp_path, drawn):
    folder, cells = suite
    for names in (["early3d", "early3d-stereo"], ["my-early3d", "my-early3d-stereo"]):
        summary = sheet(SheetRequest([folder], tmp_path / "s.svg"))
        assert texts(drawn.pop()) == (["clear", "fog"], names, [])
        assert summary.frame == 2  # has truth, though parts of the log end before
        assert summary.notes == ("4 runs of a part of a log; name run folders to see parts",)
        pq.write_table(cells, folder / "cells.parquet")


def test_runs_of_one_pipeline_are_named_by_what_differs_in_their_paths(suite, tmp_path, drawn):
    folders = [suite[0] / log / row for log in ("u-clear", "u-clear-lost-2s", "u-fog")
               for row in ("early3d", "early3d-stereo")]  # fmt: skip
    sheet(SheetRequest([*folders, folders[0]], tmp_path / "s.svg"))
    rows, lost = ["early3d", "early3d-stereo"], "loss.camera:100%"
    assert texts(drawn.pop()) == (["clear", "fog", lost], rows, ["no frame 2"] * 2)
    sheet(SheetRequest([suite[0] / log / "early3d" for log in ("u-clear", "u-clear-2s")], tmp_path / "s.svg", frame=1))
    assert texts(drawn.pop()) == (["clear"], ["early3d u-clear", "early3d u-clear-2s"], [])
    with pytest.raises(ConfigError, match=r"--frame 4: expected one that the runs have: 0 to 3$"):
        sheet(SheetRequest([suite[0]], tmp_path / "s.svg", frame=4))


def test_labels_fit_beside_their_cells(make_run, tmp_path, drawn):
    plans = [Plan(f"{i}", pipeline=f"thesis-late2d-filter-with-more-{i}", metadata=condition(f"loss.camera:100%@{j}s"))
             for i in range(3) for j in range(2)]  # fmt: skip
    runs = [make_run(replace(plan, name=str(i))).folder for i, plan in enumerate(plans)]
    sheet(SheetRequest(runs, tmp_path / "s.png"))
    figure = drawn[0]
    figure.draw_without_rendering()  # at its own resolution
    boxes = [one.yaxis.label.get_window_extent() for one in figure.axes[::2]]
    assert all(above.y0 > below.y1 for above, below in pairwise(boxes))
    left, right = (one.title.get_window_extent() for one in figure.axes[:2])
    assert left.x1 < right.x0


def test_no_runs_are_a_line(tmp_path):
    assert not is_suite([])
    for write in (lambda: sheet(SheetRequest([], tmp_path / "s.png")), lambda: tables([], tmp_path / "t"),
                  lambda: figures([], tmp_path / "f"), lambda: render([]), lambda: report([])):  # fmt: skip
        with pytest.raises(ConfigError, match=r"^expected at least one run folder, got none$"):
            write()


def test_boxes_are_where_they_were_found(make_run, tmp_path, drawn):
    plans = [Plan("a", metadata=condition("clear")),
             Plan("b", pipeline="camera2d", metadata=condition("clear"), make_boxes=boxes2d)]  # fmt: skip
    sheet(SheetRequest([make_run(plan).folder for plan in plans], tmp_path / "s.png"))
    above, image = drawn[0].axes
    truth, found = (one.get_paths()[0].vertices for one in above.collections)
    assert truth.min(axis=0).tolist() == found.min(axis=0).tolist() == [8, -1]  # 4 x 2 m, 10 m ahead
    assert truth.max(axis=0).tolist() == [12, 1]
    truth, found = (one.get_paths()[0].vertices for one in image.collections)
    assert (found.min(axis=0).tolist(), found.max(axis=0).tolist()) == ([10, 20], [50, 60])
    assert truth.min(axis=0) == pytest.approx([79.5 - 100 / 8, 59.5 - 100 / 8])  # projected: its rear, 8 m ahead
    assert image.collections[1].get_edgecolor()[0, :3].tolist() == list(drawing.of_sources(Source.C))
    assert image.images[0].get_array().shape[:2] == (480, 640)
    pixels = above.images[0].get_array()
    echo = pixels[(30 - 4) * 4, (30 + 10) * 4]  # a radar's point 30 m ahead, 4 m to the left
    assert echo.tolist() == [255, 204, 204]  # recedes with 2 m/s: a light red


def test_colors_of_sources():
    c, lidar, r = (drawing.of_sources(int(one)) for one in (Source.C, Source.L, Source.R))
    assert (max(c) == c[0], max(lidar) == lidar[1], max(r) == r[2]) == (True, True, True)
    both = drawing.of_sources(int(Source.C | Source.L))
    assert both == pytest.approx(np.minimum(np.add(c, lidar), 1))
    assert len({drawing.of_sources(mask) for mask in range(9)}) == 9
    assert drawing.of_sources(int(Source.S | Source.L)) == lidar


def test_equal_runs_give_equal_bytes(make_run, tmp_path):
    run = make_run(Plan()).folder
    for name in ("a.svg", "b.svg", "a.png", "b.png"):
        sheet(SheetRequest([run], tmp_path / name))
    for form in ("svg", "png"):
        assert (tmp_path / f"a.{form}").read_bytes() == (tmp_path / f"b.{form}").read_bytes()


def test_names_from_data_do_nothing(make_run, tmp_path):
    text = "$\\frac{$ </svg><script>x</script> \x1b[31m"
    sheet(SheetRequest([make_run(Plan(pipeline=text, metadata=condition(text))).folder], tmp_path / "s.svg"))
    assert "<script" not in Path(tmp_path / "s.svg").read_text()


def test_without_matplotlib(make_run, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match="--sheet needs matplotlib; pip install 'fbench"):
        sheet(SheetRequest([make_run(Plan()).folder], tmp_path / "s.png"))
