"""What a reader meets in a real browser: numbers, plots, a phone, the keyboard, and the page of a comparison."""

import importlib.util
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from tests.gate_runs import some, write_drive
from tests.reports.chromium import Chromium, Tab

from fbench.api import compare
from fbench.api.reports import comparison
from fbench.replay.runs.folder import Run
from fbench.reports.html import HtmlReport
from fbench.reports.html.records import number

Open = Callable[..., Tab]
READY = "document.body.dataset.drawn || document.querySelector('.brand').textContent.includes('comparison')"


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with runs `base` and `worse`, their report, and their comparison."""
    folder = tmp_path_factory.mktemp("pages")
    write_drive(folder / "base", some(0.1, 1), seconds=6)
    write_drive(folder / "worse", some(0.3, 2), alarms={3, 4, 5, 50}, swapped={40}, seconds=6)
    for name in ("base", "worse"):
        (folder / name / "faults.json").write_text('{"lost": 0, "rows": []}')
    HtmlReport().write([Run(folder / "base"), Run(folder / "worse")], folder / "report.html")
    HtmlReport().write([Run(folder / "worse")], folder / "worse" / "report.html")
    compared = compare(folder / "base", folder / "worse").comparison
    comparison(compared, folder / "base", folder / "worse", folder / "comparison.html")
    return folder


@pytest.fixture
def show(chromium: Chromium, pages: Path) -> Open:
    """Open one of the pages."""

    def open_page(name: str, width: int = 1280, dark: bool = False) -> Tab:
        tab = chromium.tab(width, dark)
        tab.open(pages / name)
        tab.wait(READY)
        return tab

    return open_page


def texts(tab: Tab, selector: str) -> list[str]:
    return list(tab.run(f"[...document.querySelectorAll({json.dumps(selector)})].map((node) => node.textContent)"))


def test_numbers_of_the_page_are_those_of_the_scores(show: Open, pages: Path) -> None:
    tab = show("report.html")
    titles, rows = texts(tab, "#summary-0 thead tr:last-child th"), texts(tab, "#summary-0 tbody td")
    metrics = {"F1": "f1", "Prec.": "precision", "Recall": "recall", "MOTA": "mota", "IDF1": "idf1", "HOTA": "hota"}
    assert titles == [*metrics, "IDSW"]
    for at, name in enumerate(("base", "worse")):
        scores = {s["metric"]: s["value"] for s in reversed(json.loads((pages / name / "scores.json").read_text()))
                  if s["class"] == "vehicle" and s["slice"] == "all"}  # fmt: skip
        shown = rows[at * 7 : at * 7 + 7]
        assert shown == [*(number(scores[metric]) for metric in metrics.values()), number(scores["idsw"], 0)]


def test_all_scores_stand_in_the_page(show: Open, pages: Path) -> None:
    scores = json.loads((pages / "worse" / "scores.json").read_text())
    tab = show("worse/report.html")
    cells = "[...row.cells].map((cell) => cell.textContent)"
    rows = tab.run(f"[...document.querySelectorAll('#scores tbody tr')].map((row) => {cells})")
    assert len(rows) == len(scores)
    for (metric, class_, part, matching, value, _), score in zip(rows, scores, strict=True):
        assert (metric, class_, part, matching) == tuple(score[k] for k in ("metric", "class", "slice", "matching"))
        if score["value"] is None:
            assert value == f"–{score['reason']}"
        else:
            shown = float(re.sub("[\u202f ].*$", "", value.replace("\u2212", "-").replace("\u202f", "")))
            assert shown == pytest.approx(score["value"], abs=6e-4)


def test_plots_and_choices(show: Open) -> None:
    tab = show("report.html")
    assert tab.run("document.querySelectorAll('#curves canvas').length") == 3
    assert texts(tab, "#worst-frames button")[0].startswith("Frame ")
    tab.run("document.querySelector('[data-show-metric=recall]').click()")
    assert tab.run("[...document.querySelectorAll('[data-metric]:not([hidden])')].map((n) => n.dataset.metric)") == [
        "recall"
    ]
    before = texts(tab, "#gantt th")
    tab.run("document.getElementById('detail-run').value = '1'")
    tab.run("document.getElementById('detail-run').dispatchEvent(new Event('change'))")
    assert texts(tab, "#gantt th") != before
    assert max(int(text or 0) for text in texts(tab, "#gantt td:nth-child(4)")) == 1  # One switch each of two objects
    tab.run("document.querySelector('#worst-frames button').click()")
    assert tab.run("document.getElementById('run').value") == "1"
    assert (tab.console, tab.asked) == ([], [])


@pytest.mark.parametrize("name", ["report.html", "worse/report.html", "comparison.html"])
def test_nothing_overflows_a_phone(show: Open, name: str) -> None:
    tab = show(name, 390)
    tab.run("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    assert tab.run("document.documentElement.scrollWidth") == 390


def test_the_keyboard_reaches_sections_and_tables(show: Open) -> None:
    tab = show("report.html")
    met = []
    for _ in range(30):
        tab.press("Tab")
        met.append(
            tab.run("(document.activeElement.textContent || document.activeElement.ariaLabel || '').slice(0, 40)")
        )
    assert "Summary" in met
    assert any("Pipeline" in name for name in met)


def test_comparison_shows_what_got_worse_first(show: Open) -> None:
    tab = show("comparison.html")
    assert texts(tab, ".banner strong") == ["REGRESSED: lidar3d: f1, vehicle, bev 2 m, within 50 m and 1 more"]
    assert texts(tab, ".changes tbody th")[:2] == ["F1", "MOTA"]
    kinds = texts(tab, ".objects-changed .tag")
    assert kinds[0] == "lost"
    assert set(kinds) == {"lost", "found", "new false alarm", "new switch"}
    assert kinds.index("found") == len(kinds) - kinds.count("found")  # What got better comes last
    assert "Outputs first differ in: lidar." in texts(tab, ".objects-changed p")[0]
    assert tab.run("document.querySelector('.links a').getAttribute('href')") == "worse/report.html"
    assert (tab.console, tab.asked) == ([], [])


def find_axe() -> str:
    """Source of axe-core."""
    spec = importlib.util.find_spec("axe_core_python")
    if spec is None or spec.origin is None:
        pytest.skip("axe-core-python isn't installed")
    return (Path(spec.origin).parent / "axe.min.js").read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("name", ["report.html", "comparison.html"])
def test_axe_finds_nothing_serious(show: Open, name: str, dark: bool) -> None:
    tab = show(name, dark=dark)
    tab.run(find_axe())
    found: list[dict[str, Any]] = tab.run("axe.run().then((result) => result.violations)")
    serious = [one for one in found if one["impact"] in ("serious", "critical")]
    assert [(one["id"], node["html"], node["failureSummary"]) for one in serious for node in one["nodes"][:3]] == []
