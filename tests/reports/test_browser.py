"""The page in a real browser: it renders, says nothing on the console, and asks nobody for anything."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.reports.chromium import Chromium, Tab
from tests.reports.conftest import Plan, boxes2d, boxes3d
from tests.reports.test_safety import hostile_plan

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.runs.folder import Run
from fbench.reports.html import HtmlReport

MakeRun = Callable[[Plan], Run]
PRESS_EVERYTHING = """
(async () => {
  const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
  const point = (node, clientX, clientY) => node.dispatchEvent(new PointerEvent("pointermove", { clientX, clientY }));
  const choose = (id, value) => {
    const select = document.getElementById(id);
    select.value = value;
    select.dispatchEvent(new Event("change"));
  };
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  for (const box of document.querySelectorAll("input[type=checkbox]")) { box.click(); box.click(); }
  for (const button of document.querySelectorAll("button")) button.click();
  for (const select of document.querySelectorAll("select")) {
    for (const option of [...select.options, select.options[0]]) choose(select.id, option?.value);
  }
  for (const canvas of document.querySelectorAll("canvas")) {
    const box = canvas.getBoundingClientRect();
    for (let x = 0; x < box.width; x += 25)
      for (let y = 0; y < box.height; y += 25) point(canvas, box.left + x, box.top + y);
    canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -120, cancelable: true }));
  }
  choose("run", String(document.getElementById("run").options.length - 1));
  choose("beside", "0");
  for (const key of ["Escape", "ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowRight", "ArrowRight"]) press(key);
})()
"""


def browse(chromium: Chromium, runs: list[Run], out: Path) -> Tab:
    """Write the report of runs, and open it."""
    HtmlReport().write(runs, out)
    tab = chromium.tab()
    tab.open(out)
    tab.wait("document.body.dataset.ready && document.body.dataset.drawn")
    return tab


def text(tab: Tab, name: str) -> str:
    """What an element says."""
    found = tab.run(f"document.getElementById({name!r})?.textContent ?? ''")
    return " ".join(str(found).split())


def has_images(tab: Tab) -> bool:
    return bool(tab.run("document.images.length"))


def test_page_renders_quietly_and_alone(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    tab = browse(chromium, [make_run(Plan(missing={"radar": "timeout"}))], tmp_path / "report.html")
    assert text(tab, "where") == "Frame 0 of 4 · 0.00 s · segment 0"
    tab.wait("document.getElementById('objects').textContent.includes('track #7 · car')")
    assert (tab.console, tab.asked) == ([], [])


def test_controls_work_with_hostile_names(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    second = Plan(name="second", pipeline="camera2d", make_boxes=boxes2d)
    tab = browse(chromium, [make_run(hostile_plan()), make_run(second)], tmp_path / "report.html")
    tab.run(PRESS_EVERYTHING)
    assert text(tab, "where") == "Frame 2 of 4 · 5.20 s · segment 1"
    tab.wait("document.getElementById('objects').textContent.includes('track #3 · car')")
    assert not has_images(tab)
    assert (tab.console, tab.asked) == ([], [])


def test_damaged_boxes_are_listed_and_not_drawn(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    def damaged(label: str) -> Boxes3D:
        return replace(boxes3d(label), center_m=np.array([[np.nan, 0, 0]]))

    tab = browse(chromium, [make_run(Plan(make_boxes=damaged))], tmp_path / "report.html")
    tab.wait("document.getElementById('objects').textContent.includes('track #7 · car invalid, not drawn')")
    assert "2D" not in text(tab, "camera-note")
    assert tab.console == []


@pytest.mark.parametrize("others", [[], [Plan(name="second", pipeline="radar3d")]])
def test_run_without_frames_renders(chromium: Chromium, make_run: MakeRun, tmp_path: Path, others: list[Plan]) -> None:
    empty = Plan(num_frames=0, scores=None, latency=None)
    tab = browse(chromium, [make_run(plan) for plan in [empty, *others]], tmp_path / "report.html")
    assert text(tab, "where") == ("Frame 0 of 4 · 0.00 s · segment 0" if others else "")
    assert tab.console == []


def test_check_sees_a_request(chromium: Chromium, tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text("<body><img src='http://127.0.0.1:9/x.png'><script>console.log('said')</script></body>")
    tab = chromium.tab()
    tab.open(page)
    assert "said" in tab.console
    assert tab.asked == ["http://127.0.0.1:9/x.png"]


def test_policy_stops_scripts_and_styles_that_are_not_ours(
    chromium: Chromium, make_run: MakeRun, tmp_path: Path
) -> None:
    out = tmp_path / "report.html"
    HtmlReport().write([make_run(Plan())], out)
    strange = "<script>document.title = 'taken'</script><p id='p' style='color: red' onclick='1'></p></body>"
    out.write_text(out.read_text("utf-8").replace("</body>", strange), "utf-8")
    tab = chromium.tab()
    tab.open(out)
    assert tab.run("document.title") == "street · fbench"
    assert tab.run("document.getElementById('p').style.color") == ""
