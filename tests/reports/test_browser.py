"""The page in a real browser: it renders, says nothing on the console, and asks nobody for anything."""

import json
import os
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from tests.reports.conftest import Plan, boxes2d, boxes3d
from tests.reports.test_safety import hostile_plan

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.runs.folder import Run
from fbench.replay.runs.outcomes import save_outcomes
from fbench.reports.html import HtmlReport

MakeRun = Callable[[Plan], Run]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PICTURES = """
<script>
// Virtual time passes without pictures of the screen, so they come by a timer.
window.requestAnimationFrame = (act) => setTimeout(() => act(performance.now()), 16);
</script></head>
"""
PRESS_EVERYTHING = """
<script>
const press = (key) => document.body.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
const point = (node, clientX, clientY) => node.dispatchEvent(new PointerEvent("pointermove", { clientX, clientY }));
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
const choose = (id, value) => {
  const select = document.getElementById(id);
  select.value = value;
  select.dispatchEvent(new Event("change"));
};
(async () => {
  await pause(200);
  for (const box of document.querySelectorAll("input[type=checkbox]")) { box.click(); box.click(); }
  for (const button of document.querySelectorAll("button")) button.click();
  for (const canvas of document.querySelectorAll("canvas")) {
    const box = canvas.getBoundingClientRect();
    for (let x = 0; x < box.width; x += 24)
      for (let y = 0; y < box.height; y += 24) point(canvas, box.left + x, box.top + y);
    canvas.dispatchEvent(new WheelEvent("wheel", { deltaY: -120, cancelable: true }));
  }
  choose("run", String(document.getElementById("run").options.length - 1));
  choose("beside", "0");
  await pause(200);
  for (const key of ["Escape", "ArrowLeft", "ArrowLeft", "ArrowLeft", "ArrowRight", "ArrowRight"]) press(key);
  await pause(200);
  document.body.dataset.pressed = "true";
})();
</script></body>
"""
PLAY = """
<script>
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
(async () => {
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
  document.body.dataset.said = JSON.stringify(said);
})();
</script></body>
"""


class Body(HTMLParser):
    """Attributes of the body, tags, and texts by id."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.body, self.tags, self.texts, self._id = dict[str, str | None](), list[str](), dict[str, str](), ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self._id = dict(attrs).get("id") or self._id
        if tag == "body":
            self.body = dict(attrs)

    def handle_data(self, data: str) -> None:
        self.texts[self._id] = self.texts.get(self._id, "") + data


def browse(page: Path, scratch: Path) -> tuple[Body, str, list[str]]:
    """Open a page; returns what became of it, the console's lines, and addresses that the page asked for."""
    if BROWSER is None:
        pytest.skip("no chromium, chromium-browser or google-chrome is installed")
    log = scratch / "net.json"
    command = [
        BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
        "--disable-background-networking", "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage",
        "--enable-logging=stderr", "--v=0", "--window-size=1280,900", "--virtual-time-budget=20000",
        f"--user-data-dir={scratch / 'profile'}", f"--log-net-log={log}", "--dump-dom", page.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=120, env={**os.environ, "HOME": str(scratch)}
    )
    console = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    return Body(done.stdout), "\n".join(console), requests(log)


def requests(log: Path) -> list[str]:
    """Addresses on the network that the page asked for; the browser's own errands have no origin."""
    content = json.loads(log.read_text())
    params = [event.get("params", {}) for event in content["events"]]
    asked = [p for p in params if str(p.get("url", "")).startswith(("http", "ws", "ftp"))]
    return [p["url"] for p in asked if p.get("initiator", "not an origin") != "not an origin"]


def test_page_renders_quietly_and_alone(make_run: MakeRun, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    HtmlReport().write([make_run(Plan(missing={"radar": "timeout"}))], out)
    body, console, asked = browse(out, tmp_path)
    assert body.body.get("data-ready") == "true"
    assert body.texts["where"].strip() == "Frame 0 of 4 · 0.00 s · segment 0"
    assert "track #7 · car" in body.texts["objects"]
    assert console == ""
    assert asked == []


def test_controls_work_with_hostile_names(make_run: MakeRun, tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    second = Plan(name="second", pipeline="camera2d", make_boxes=boxes2d)
    HtmlReport().write([make_run(hostile_plan()), make_run(second)], out)
    html = out.read_text("utf-8")
    out.write_text(html.replace("</head>", PICTURES).replace("</body>", PRESS_EVERYTHING), "utf-8")
    body, console, asked = browse(out, tmp_path)
    assert body.body.get("data-pressed") == "true"
    assert body.texts["where"].strip() == "Frame 2 of 4 · 5.20 s · segment 1"
    assert "track #3 · car" in body.texts["objects"]
    assert "img" not in body.tags
    assert console == ""
    assert asked == []


def test_player(make_run: MakeRun, tmp_path: Path) -> None:
    """Frame 1 has a false alarm and frame 3 a miss; it begins with the first of the frames with most errors."""
    runs = [make_run(Plan()), make_run(Plan(name="second", pipeline="radar3d"))]
    save_outcomes(runs[0].folder, {
        "truth": {(0, ""): "hit", (3, ""): "missed"}, "detections": {(0, ""): "hit", (1, ""): "false alarm"},
    })  # fmt: skip
    out = tmp_path / "report.html"
    HtmlReport().write(runs, out)
    out.write_text(out.read_text("utf-8").replace("</head>", PICTURES).replace("</body>", PLAY), "utf-8")
    body, console, asked = browse(out, tmp_path)
    said = {what: rest for what, *rest in json.loads(body.body.get("data-said") or "[]")}
    assert (console, asked) == ("", [])
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


def test_damaged_boxes_are_listed_and_not_drawn(make_run: MakeRun, tmp_path: Path) -> None:
    def damaged(label: str) -> Boxes3D:
        return replace(boxes3d(label), center_m=np.array([[np.nan, 0, 0]]))

    out = tmp_path / "report.html"
    HtmlReport().write([make_run(Plan(make_boxes=damaged))], out)
    body, console, _ = browse(out, tmp_path)
    assert "track #7 · car invalid, not drawn" in body.texts["objects"]
    assert "2D" not in body.texts["camera-note"]
    assert console == ""


@pytest.mark.parametrize("others", [[], [Plan(name="second", pipeline="radar3d")]])
def test_run_without_frames_renders(make_run: MakeRun, tmp_path: Path, others: list[Plan]) -> None:
    out = tmp_path / "report.html"
    empty = Plan(num_frames=0, scores=None, latency=None)
    HtmlReport().write([make_run(plan) for plan in [empty, *others]], out)
    body, console, _ = browse(out, tmp_path)
    assert body.body.get("data-ready") == "true"
    assert body.texts.get("where", "").strip() == ("Frame 0 of 4 · 0.00 s · segment 0" if others else "")
    assert console == ""


def test_check_sees_a_request(tmp_path: Path) -> None:
    page = tmp_path / "bad.html"
    page.write_text("<body><img src='http://127.0.0.1:9/x.png'><script>console.log('said')</script></body>")
    _, console, asked = browse(page, tmp_path)
    assert "said" in console
    assert asked
