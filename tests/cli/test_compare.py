"""`fbench compare` and `fbench baseline`: exit codes, files for CI, and comparisons without labels."""

import json
import re
from itertools import product
from pathlib import Path
from xml.etree import ElementTree

import pytest
from ruamel.yaml import YAML
from tests.city_log import write_city_log
from tests.gate_runs import some, write_drive

from fbench.api.gates import load_policy
from fbench.cli.pytest_plugin import require_no_regression
from fbench.reports.ci import FORMATS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    write_drive(folder / "base", some(0.1, 1))
    write_drive(folder / "worse", some(0.3, 2))
    write_drive(folder / "dark", has_truth=False)
    write_drive(folder / "dark-worse", {(i, 1) for i in range(50, 90)}, has_truth=False)
    return folder


def test_a_loss_is_exit_1_with_reasons_and_files(fbench, runs, tmp_path):
    policy = tmp_path / "gate.toml"
    policy.write_text("version = 1\n", encoding="utf-8")
    files = {kind: tmp_path / f"out/{kind}" for kind in ("junit", "markdown", "github", "json")}
    targets = [word for kind, path in files.items() for word in ("--write", f"{kind}={path}")]
    result = fbench("compare", runs / "base", runs / "worse", "--policy", policy, *targets)
    assert result.code == 1
    assert "REGRESSED: lidar3d: f1, vehicle, bev 2 m, within 50 m" in result.out
    assert "first difference: log through lidar3d: frame 0 (0.0 s), lidar: its result differs" in result.out
    assert "LOST car #" in result.out
    assert "::error title=fbench%3A f1 REGRESSED::" in result.err
    assert all(path.is_file() for path in files.values())
    assert json.loads(files["json"].read_text(encoding="utf-8"))["regressed"] is True


def test_a_report_shows_what_got_worse_and_leads_to_the_runs(fbench, runs, tmp_path):
    for name in ("base", "worse"):
        (runs / name / "faults.json").write_text('{"lost": 0, "rows": []}', encoding="utf-8")
    assert fbench("report", runs / "worse", "--base", runs / "base").code == 0
    page = (runs / "worse" / "report.html").read_text(encoding="utf-8")
    assert '<div class="banner bad" role="alert" id="verdict">' in page
    assert "<b>REGRESSED</b> lidar3d: f1, vehicle, bev 2 m, within 50 m:" in page
    result = fbench("compare", runs / "base", runs / "worse", "--report", tmp_path / "new" / "comparison.html")
    assert (result.code, "comparison.html" in result.err) == (1, True)
    text = (tmp_path / "new" / "comparison.html").read_text(encoding="utf-8")
    assert "REGRESSED: lidar3d: f1, vehicle, bev 2 m, within 50 m and 1 more" in text
    (link,) = re.findall('<a href="([^"#]+)">Report of head', text)
    assert (tmp_path / "new" / link).resolve() == (runs / "worse" / "report.html").resolve()
    again = fbench("compare", runs / "base", runs / "worse", "--report", tmp_path / "new" / "again.html")
    assert again.code == 1
    assert (tmp_path / "new" / "again.html").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("report", "worse", "base", "--base", "base"), "--base is for the report of kind html of one RUN"),
        (("report", "worse", "--base", "nothing"), "nothing: no such run folder"),
        (("compare", "base", "worse", "--report", "base/manifest.json/x.html"), "x.html: can't be written"),
    ],
)
def test_a_report_that_cant_be_is_one_line(fbench, runs, monkeypatch, words, why):
    monkeypatch.chdir(runs)
    result = fbench(*words)
    assert (result.code, why in result.err, result.err.count("\n")) == (2, True, 1)


def test_without_labels_the_base_is_the_reference(fbench, runs):
    refused = fbench("compare", runs / "dark", runs / "dark-worse")
    assert (refused.code, "--reference base" in refused.err) == (3, True)
    result = fbench("compare", runs / "dark", runs / "dark-worse", "--reference", "base", "--json")
    assert result.code == 0
    found = result.json()
    rows = {row["metric"]: row for row in found["rows"] if row["slice"] == "all"}
    near = {row["slice"]: row["head"] for row in found["rows"] if row["metric"] == "agreement_detections"}
    assert (near["range 10-20 m"], near["range 20-30 m"]) == (pytest.approx(400 / 440), 1.0)
    assert rows["agreement_detections"]["head"] == pytest.approx(2 * 440 / (480 + 440))
    assert rows["agreement_detections"]["verdict"] == "changed"
    first = found["objects"][0]
    assert (first["kind"], first["track_id"], first["frames"]) == ("LOST", 1, [50, 89])
    same = fbench("compare", runs / "dark", runs / "dark", "--reference", "base", "--json").json()
    assert (same["state"], same["objects"]) == ("identical", [])


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--policy", "no.toml"), 2, "no.toml: can't be read"),
        (("--policy", "x", "--tolerance", "1"), 2, "--tolerance goes without --policy"),
        (("--write", "junti=x"), 2, "did you mean 'junit'"),
        (("--link", "https://ci.example/17"), 2, "--link: is for a comment; give --write markdown=FILE"),
        (("--link", "ci.example", "--write", "markdown=x.md"), 2, "expected an address such as https://"),
    ],
)
def test_wrong_options(fbench, runs, words, code, said):
    result = fbench("compare", runs / "base", runs / "worse", *words)
    assert result.code == code
    assert said in result.err


def test_a_baseline_is_accepted_and_compared_with(fbench, runs):
    words = ("--reason", "first", "--by", "Ada", "--at", "2026-01-02", "-o", "baseline.json")
    accepted = fbench("baseline", "accept", runs / "base", *words)
    assert accepted.code == 0
    assert "accepted by Ada on 2026-01-02: first" in accepted.out
    assert fbench("compare", "baseline.json", runs / "base").out.endswith("identical: all outputs have equal digests\n")
    assert fbench("compare", "baseline.json", runs / "worse").code == 1
    assert "no such run folder" in fbench("baseline", "accept", "nothing", *words).err


def test_the_fixture_fails_a_test_with_reasons(runs):
    assert not require_no_regression(runs / "base", runs / "base").is_worse
    with pytest.raises(pytest.fail.Exception, match="REGRESSED: lidar3d: f1"):
        require_no_regression(runs / "base", runs / "worse")


def test_examples_for_ci_say_what_the_program_takes(fbench):
    load_policy(ROOT / "examples/ci/gate.toml")
    yaml = YAML(typ="safe")
    github = yaml.load((ROOT / "examples/ci/github.yml").read_text(encoding="utf-8"))
    steps = [step["run"] for step in github["jobs"]["gate"]["steps"] if "run" in step]
    gitlab = yaml.load((ROOT / "examples/ci/gitlab.yml").read_text(encoding="utf-8"))
    options = fbench("compare", "--help").out
    for command in (*steps, *gitlab["perception"]["script"]):
        if command.startswith("fbench compare"):
            assert "--policy gate.toml" in command
            assert all(word in options for word in command.split() if word.startswith("--"))
    assert gitlab["perception"]["artifacts"]["reports"] == {"junit": "gate.xml", "metrics": "metrics.txt"}


def test_other_pipelines_narrow_intervals_of_few_labels(fbench, runs, tmp_path):
    write_drive(tmp_path / "few", some(0.3, 5), every=3)
    write_drive(tmp_path / "like", some(0.03, 6), has_truth=False, pipeline="late3d")
    words = ("score", tmp_path / "few", "--control", tmp_path / "like")
    found = fbench(*words, "--json").json()
    assert (found["recall"]["num_labeled"], found["recall"]["num_frames"]) == (40, 120)
    assert found["recall"]["plain"]["value"] == pytest.approx(
        1 - sum(i % 3 == 0 for i, _ in some(0.3, 5)) / 160, abs=1e-6
    )
    assert found["recall"]["gain"] > 0.3
    text = fbench(*words).out
    assert "40 of 120 frames are labeled" in text


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("base", "--control", "worse"), 3, "every frame is labeled"),
        (("base", "--control", "worse", "--range-m", "30"), 2, "doesn't go with --control"),
        (("--control", "worse"), 2, "what is to be scored?"),
        (("base", "--control", "nowhere"), 2, "no such run folder"),
    ],
)
def test_wrong_controls_are_one_line(fbench, runs, words, code, said):
    found = fbench("score", *(runs / w if w in ("base", "worse", "nowhere") else w for w in words))
    assert (found.code, said in found.err) == (code, True)
    assert found.err.count("\n") == 1


@pytest.mark.slow
def test_suites_from_init_to_a_red_gate(fbench, tmp_path):
    """Two logs under two conditions: equal bits are identical, a changed variant regresses by name."""
    for number, world in enumerate(("urban", "highway")):
        write_city_log(tmp_path / f"{world}.mcap", 5.0, number, world)
    variant, text = tmp_path / "mine.toml", 'name = "mine"\nbase = "lidar3d"\n[parameters.lidar.cluster]\neps_m = {}\n'
    variant.write_text(text.format(0.6), encoding="utf-8")
    words = ("*.mcap", "-p", "mine.toml", "--condition", "dropout:2", "-o", "suite.toml")
    assert "suite: suite.toml (4 cells)" in fbench("bench", "init", *words).out
    for name, radius in (("base", 0.6), ("again", 0.6), ("head", 0.15)):
        variant.write_text(text.format(radius), encoding="utf-8")
        result = fbench("bench", "suite.toml", "--jobs", 2, "-o", name)
        assert (result.code, "cells: 4 of 4 (4 replayed" in result.out) == (0, True)
    (tmp_path / "gate.toml").write_text("version = 1\n", encoding="utf-8")
    files = {kind: tmp_path / f"out/{kind}" for kind in FORMATS}
    targets = [word for kind, path in files.items() for word in ("--write", f"{kind}={path}")]
    same = fbench("compare", "base", "again", "--policy", "gate.toml", *targets)
    assert (same.code, same.out.splitlines()[-1]) == (0, "identical: all outputs have equal digests")
    assert not files["markdown"].exists()
    worse = fbench("compare", "base", "head", "--policy", "gate.toml", *targets)
    assert worse.code == 1
    assert worse.out.splitlines()[-1].startswith("REGRESSED: mine: f1, vehicle")
    assert "first difference: urban through mine (dropout:2): frame 0 (0.0 s), lidar" in worse.out
    assert re.search(r"^(urban|highway) through mine.*: LOST car #", worse.out, re.MULTILINE)
    found = json.loads(files["json"].read_text(encoding="utf-8"))
    gating = {(row["condition"], row["metric"]): row["verdict"] for row in found["rows"] if row["gate"]}
    assert gating == dict.fromkeys(product(("clear", "dropout:2"), ("f1", "mota")), "REGRESSED")
    assert {cell["cell"] for cell in found["divergences"]} == {
        f"{log} through mine{condition}" for log in ("urban", "highway") for condition in ("", " (dropout:2)")
    }
    assert "❌ | mine dropout:2: f1, vehicle" in files["markdown"].read_text(encoding="utf-8")
    assert ElementTree.parse(files["junit"]).getroot().get("failures") == "4"  # noqa: S314  # our own
