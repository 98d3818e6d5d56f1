"""The player in a real browser: steps, errors, filters, orbit, two runs in step, and clips of a comparison."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.reports.chromium import Chromium, Tab
from tests.reports.conftest import Plan, boxes2d

from fbench.replay.data.comparison import Comparison, ObjectChange
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame, Points
from fbench.replay.runs.outcomes import save_outcomes
from fbench.reports.html import HtmlReport
from fbench.reports.html.comparison import Links, write_comparison
from fbench.reports.html.page import page

MakeRun = Callable[[Plan], Run]
PIXELS = """
(() => {
  const canvas = document.getElementById("%s");
  const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
  return data.reduce((sum, value) => sum + value, 0);
})()
"""


def open_page(chromium: Chromium, out: Path, width: int = 1280) -> Tab:
    tab = chromium.tab(width)
    tab.open(out)
    tab.wait("document.getElementById('objects').rows.length")
    return tab


def choose(tab: Tab, name: str, value: str) -> None:
    tab.run(f"(() => {{ const s = document.getElementById('{name}'); s.value = '{value}'; "
            "s.dispatchEvent(new Event('change')); })()")  # fmt: skip


def press(tab: Tab, *keys: str) -> None:
    for key in keys:
        tab.run(f"document.body.dispatchEvent(new KeyboardEvent('keydown', {{ key: '{key}', bubbles: true }}))")


def wait_for(tab: Tab, name: str, text: str) -> None:
    tab.wait(f"document.getElementById('{name}').innerText.startsWith('{text}')")


def painted(tab: Tab, name: str) -> int:
    """Sum of the pixels of a canvas, once it is drawn."""
    tab.run("new Promise((done) => requestAnimationFrame(() => setTimeout(done, 50)))")
    return int(tab.run(PIXELS % name))


def rows(tab: Tab) -> list[str]:
    table = "[...document.getElementById('objects').rows]"
    return list(tab.run(f"{table}.map((row) => [0, 1].map((i) => row.cells[i].innerText.trim()).join(': '))"))


def test_player(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    """Frame 1 has a false alarm and frame 3 a miss; it begins with the first of the frames with most errors."""
    runs = [make_run(Plan()), make_run(Plan(name="second", pipeline="radar3d"))]
    save_outcomes(runs[0].folder, {
        "truth": {(0, ""): "hit", (3, ""): "missed"}, "detections": {(0, ""): "hit", (1, ""): "false alarm"},
    })  # fmt: skip
    out = tmp_path / "report.html"
    HtmlReport().write(runs, out)
    tab = open_page(chromium, out)
    wait_for(tab, "where", "Frame 1 of 4")
    press(tab, "p")
    wait_for(tab, "where", "No earlier frame has such an error")
    press(tab, "n")
    wait_for(tab, "where", "Frame 3 of 4")
    tab.wait("document.getElementById('objects').innerText.includes('missed')")
    # Errors come first among those of one kind.
    assert rows(tab) == ["track #7 · car: –", "detection #7 · car: –", "truth #7 · car: missed"]
    choose(tab, "only", "missed")
    assert rows(tab) == ["truth #7 · car: missed"]
    press(tab, "p")
    wait_for(tab, "where", "No earlier frame has such an error")
    choose(tab, "only", "")
    flat = painted(tab, "scene")
    press(tab, "o")
    assert painted(tab, "scene") not in (0, flat)
    choose(tab, "beside", "1")
    assert tab.run("['who', 'who-2'].map((id) => document.getElementById(id).textContent)") == ["late3d", "radar3d"]
    assert painted(tab, "scene-2") > 0
    assert painted(tab, "camera-2") > 0
    tab.run("document.querySelector('#objects button').click()")
    wait_for(tab, "object", "track #7")
    press(tab, "Escape")
    assert tab.run("document.getElementById('object').hidden")
    choose(tab, "run", "1")
    press(tab, "ArrowLeft", "ArrowLeft", "ArrowLeft")
    wait_for(tab, "where", "Frame 0 of 4")
    press(tab, " ")
    wait_for(tab, "play", "Pause")
    wait_for(tab, "play", "Play")
    wait_for(tab, "where", "Frame 3 of 4")
    assert (tab.console, tab.asked) == ([], [])


def test_what_the_budget_leaves_out_is_said(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    out, points = tmp_path / "report.html", np.random.default_rng(0).normal(0, 20, (9000, 3)).astype(np.float32)
    run = make_run(Plan())
    vars(run)["media"] = tuple(
        MediaFrame(i, {}, {"top": Points(points + i, np.full(9000, np.nan, np.float32))}) for i in range(4)
    )
    out.write_text(page([run], budget_mb=0.54), "utf-8")
    tab = open_page(chromium, out, 390)
    said = str(tab.run("document.getElementById('left-out').innerText"))
    assert "the images and points of" in said
    assert tab.run("document.documentElement.scrollWidth") <= 390
    assert tab.console == []


@pytest.mark.parametrize("plan", [Plan(), Plan(make_boxes=boxes2d)])
def test_comparison_shows_clips(chromium: Chromium, make_run: MakeRun, tmp_path: Path, plan: Plan) -> None:
    base, head = make_run(plan), make_run(Plan(name="head", make_boxes=plan.make_boxes))
    changes = (
        ObjectChange("LOST", "cell", "car", 7, 5.3, 5.3, (3, 3), 1, 10.0, "because", (10.0, 0.0)),
        ObjectChange("NEW FALSE ALARM", "cell", "car", None, 0.0, 0.1, (0, 1), 2, 10.0, "because", (10.0, 0.0)),
    )
    out = tmp_path / "comparison.html"
    pairs = {"cell": (base, head)}
    write_comparison(Comparison((), 0.0, "failed", objects=changes), pairs, ("main", "branch"), Links(None, None), out)
    tab = open_page(chromium, out)
    wait_for(tab, "clip", "LOST car #7")
    wait_for(tab, "where", "Frame 3 of 4")
    assert tab.run("['who', 'who-2'].map((id) => document.getElementById(id).textContent)") == ["main", "branch"]
    assert painted(tab, "scene") > 0
    tab.run("document.querySelector('[data-clip=\"1\"]').click()")
    wait_for(tab, "clip", "NEW FALSE ALARM car")
    wait_for(tab, "play", "Pause")
    assert tab.run("document.querySelector('[data-clip=\"1\"]').getAttribute('aria-pressed')") == "true"
    press(tab, " ")
    assert (tab.console, tab.asked) == ([], [])
    write_comparison(Comparison((), 0.0, "failed", objects=changes), {}, ("a", "b"), Links(None, None), out)
    tab.open(out)
    assert not tab.run("document.querySelectorAll('[data-clip], #viewer').length")
    assert tab.console == []
