"""Frames a second of the report's player in headless Chromium (software rendering), with 20,000 points in each frame.

Run it from the root of the repository; without a LOG it simulates one.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the browser that tests drive

from tests.city_log import write_city_log
from tests.reports.chromium import start

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.replay.runs.folder import Run
from fbench.replay.runs.media import MediaFrame, Points
from fbench.reports.html.page import page

NUM_POINTS = 20_000
DRAG = """
new Promise((done) => {
  const canvas = document.getElementById("scene"), box = canvas.getBoundingClientRect(), begin = performance.now();
  let num = 0;
  const send = (name, x, y) => canvas.dispatchEvent(new PointerEvent(name,
    {pointerId: 1, clientX: box.left + 200 + x, clientY: box.top + 200 + y, bubbles: true}));
  const step = () => {
    num += 1;
    send("pointermove", num % 100, num % 50);
    if (performance.now() - begin < 4000) requestAnimationFrame(step);
    else done(1000 * num / (performance.now() - begin));
  };
  HTMLElement.prototype.setPointerCapture = () => {};
  send("pointerdown", 0, 0);
  requestAnimationFrame(step);
})
"""
BESIDE = """
(() => { const beside = document.getElementById("beside"); beside.value = "1";
  beside.dispatchEvent(new Event("change")); })()
"""


def fill(folder: Path) -> Run:
    """Return a run whose frames all have so many points."""
    run = Run(folder)
    kept, media = run.media, []
    for at, frame in enumerate(run.frames):
        own, random = kept[at % len(kept)], np.random.default_rng(at)
        xyz = random.uniform((-50, -50, 0), (50, 50, 4), (NUM_POINTS, 3)).astype(np.float32)
        points = {"lidar": Points(xyz, np.full(NUM_POINTS, np.nan, np.float32))}
        media.append(MediaFrame(frame.index, own.pictures, points))
    vars(run)["media"] = tuple(media)
    return run


def main() -> None:
    """Print frames a second from above, in 3D, and of two runs in 3D."""
    parser = argparse.ArgumentParser()
    parser.add_argument("log", type=Path, nargs="?")
    log = parser.parse_args().log
    with tempfile.TemporaryDirectory() as temporary:
        folder, runs = Path(temporary), list[Run]()
        if log is None:
            write_city_log(log := folder / "city.mcap", 1.0, cameras=True)
        for name in ("lidar3d", "radar3d"):
            replay(ReplayRequest(LogRequest(log), name, out=folder / name))
            runs.append(fill(folder / name))
        path = folder / "report.html"
        path.write_text(page(runs), encoding="utf-8")
        with start(folder) as browser:
            tab = browser.tab()
            tab.open(path)
            tab.run("document.getElementById('viewer').scrollIntoView()")
            print(f"from above: {tab.run(DRAG):.0f} frames/s")
            tab.run("document.getElementById('tilt').click()")
            print(f"in 3D: {tab.run(DRAG):.0f} frames/s")
            tab.run(BESIDE)
            print(f"two runs in 3D: {tab.run(DRAG):.0f} frames/s")


if __name__ == "__main__":
    main()
