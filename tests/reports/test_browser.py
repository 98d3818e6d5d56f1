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
from fbench.replay.runs.outcomes import save_outcomes
from fbench.reports.html import HtmlReport

MakeRun = Callable[[Plan], Run]
PRESS_EVERYTHING = """
(async () => {
  const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
  const point = (node, clientX, clientY) => node.dispatchEvent(new PointerEvent("pointermove", { clientX, clientY }));
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
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
  await pause(200);
  for (const key of ["Escape", "ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowRight", "ArrowRight"]) press(key);
  await pause(200);
})()
"""
PLAY = """
(async () => {
  const $ = (id) => document.getElementById(id);
  const said = [];
  const pause = (ms) => new Promise((done) => setTimeout(done, ms));
  const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
  const choose = (id, value) => { $(id).value = value; $(id).dispatchEvent(new Event("change")); };
  const say = async (what) => { await pause(200); said.push([what, $("where").textContent.split(" · ")[0]]); };
  const seen = (id) => {
    const { width, height } = $(id);
    return $(id).getContext("2d").getImageData(0, 0, width, height).data.reduce((sum, value) => sum + value, 0);
  };
  const rows = () => [...$("objects").rows].map((row) => [0, 1].map((i) => row.cells[i].innerText.trim()).join(": "));
  await say("begin");
  press("p"); await say("error before");
  press("p"); await say("none before");
  press("n"); await say("error after");
  said.push(["rows", rows().join(", ")]);
  choose("only", "missed"); await say("filter");
  said.push(["missed rows", rows().join(", ")]);
  press("p"); await say("no missed before");
  choose("only", ""); choose("color", "source");
  const flat = seen("scene");
  press("o"); await say("orbit");
  said.push(["orbit", seen("scene") !== flat]);
  choose("beside", "1"); await say("beside");
  said.push(["two", $("who").textContent, $("who-2").textContent, seen("scene-2") > 0, seen("camera-2") > 0]);
  document.querySelector("#objects button").click(); await say("follow");
  said.push(["object", $("object").textContent]);
  press("Escape");
  choose("run", "1"); await say("switch");
  for (const _ of [1, 2, 3]) press("ArrowLeft");
  choose("speed", "4"); press(" "); await pause(2000); await say("played");
  return said;
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
    assert "track #7 · car" in text(tab, "objects")
    assert (tab.console, tab.asked) == ([], [])


def test_controls_work_with_hostile_names(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    second = Plan(name="second", pipeline="camera2d", make_boxes=boxes2d)
    tab = browse(chromium, [make_run(hostile_plan()), make_run(second)], tmp_path / "report.html")
    tab.run(PRESS_EVERYTHING)
    assert text(tab, "where") == "Frame 2 of 4 · 5.20 s · segment 1"
    assert "track #3 · car" in text(tab, "objects")
    assert not has_images(tab)
    assert (tab.console, tab.asked) == ([], [])


def test_player(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    """Frame 1 has a false alarm and frame 3 a miss; it begins with the first of the frames with most errors."""
    runs = [make_run(Plan()), make_run(Plan(name="second", pipeline="radar3d"))]
    save_outcomes(runs[0].folder, {
        "truth": {(0, ""): "hit", (3, ""): "missed"}, "detections": {(0, ""): "hit", (1, ""): "false alarm"},
    })  # fmt: skip
    tab = browse(chromium, runs, tmp_path / "report.html")
    said = {what: rest for what, *rest in tab.run(PLAY)}
    assert (tab.console, tab.asked) == ([], [])
    assert said["begin"] == ["Frame 1 of 4"]
    assert said["error before"] == said["none before"] == ["No earlier frame has such an error"]
    assert said["error after"] == ["Frame 3 of 4"]
    assert said["rows"] == ["track #7 · car: –, detection #7 · car: –, truth #7 · car: missed"]
    assert said["missed rows"] == ["truth #7 · car: missed"]
    assert said["no missed before"] == ["No earlier frame has such an error"]
    assert said["orbit"] == [True]
    assert said["two"] == ["late3d", "radar3d", True, True]
    assert said["object"] == ["track #7 ×"]
    assert said["played"] == ["Frame 3 of 4"]


def test_damaged_boxes_are_listed_and_not_drawn(chromium: Chromium, make_run: MakeRun, tmp_path: Path) -> None:
    def damaged(label: str) -> Boxes3D:
        return replace(boxes3d(label), center_m=np.array([[np.nan, 0, 0]]))

    tab = browse(chromium, [make_run(Plan(make_boxes=damaged))], tmp_path / "report.html")
    assert "track #7 · car invalid, not drawn" in text(tab, "objects")
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
