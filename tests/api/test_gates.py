"""Gates: runs, suites and baselines by a policy; what can't be judged is no pass."""

import json
import shutil
from pathlib import Path

import pytest
from tests.gate_runs import some, write_cells, write_drive

from fbench.api.baselines import accept, load_baseline
from fbench.api.gates import CompareRequest, compare_sides, load_policy
from fbench.replay.contracts.errors import ConfigError, FbenchError, MetricError, RunError
from fbench.replay.data.comparison import Comparison, Row
from fbench.replay.runs.manifest import LogEntry

GATE = 'version = 1\n[[gate]]\nmetric = "f1"\n'


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Runs of one log: `base`, `noop` with equal bits, `noise` of equal quality, `worse`, and others."""
    folder = tmp_path_factory.mktemp("gate")
    few = some(0.1, 1)
    write_drive(folder / "base", few)
    write_drive(folder / "noop", few)
    write_drive(folder / "noise", some(0.1, 2))
    write_drive(folder / "worse", few | some(0.2, 3) | {(i, 2) for i in range(40, 60)})
    write_drive(folder / "alarms", few, alarms=range(30, 50), swapped=(70,))
    log = LogEntry(name="other", log_id="other", digest="e" * 32, metadata={})
    write_drive(folder / "other", few, log=log, seconds=2)
    return folder


def compare(base: Path, head: Path, policy: str | None = None, tolerance: float = 0.0) -> Comparison:
    path = None
    if policy is not None:
        path = head.parent / "gate.toml"
        path.write_text(f"version = 1\n{policy}", encoding="utf-8")
    return compare_sides(CompareRequest(base, head, tolerance, path))


def row(found: Comparison, metric: str, part: str = "all") -> Row:
    return next(r for r in found.rows if (r.metric, r.class_, r.slice) == (metric, "vehicle", part))


def test_equal_bits_are_identical(runs: Path) -> None:
    found = compare(runs / "base", runs / "noop", "")
    assert found.state == "identical"
    assert {r.verdict for r in found.rows} <= {"identical", "null"}
    assert not found.divergences
    assert not found.objects


def test_other_bits_of_equal_quality_are_no_regression(runs: Path) -> None:
    found = compare(runs / "base", runs / "noise", "")
    assert found.state in ("passed", "inconclusive")
    assert {r.verdict for r in found.gating} <= {"same", "INCONCLUSIVE"}
    assert row(found, "f1").low is not None


def test_a_planted_loss_regresses_and_names_object_stage_and_frame(runs: Path) -> None:
    found = compare(runs / "base", runs / "worse", "")
    assert found.state == "failed"
    f1 = row(found, "f1")
    assert f1.verdict == "REGRESSED"
    assert f1.high is not None
    assert f1.high < 0
    assert f1.p is not None
    assert f1.p < 0.05
    assert f1.num_units == 12
    assert row(found, "recall", "range 20-30 m").verdict == "REGRESSED"
    first = found.divergences[0]
    lost = {(2, i) for i in range(40, 60)}
    assert first.stage == "lidar"
    assert first.frame == min(i for i in range(120) if {n for n in range(4) if (i, n) in some(0.2, 3)} - {
        n for n in range(4) if (i, n) in some(0.1, 1)})  # fmt: skip
    change = next(c for c in found.objects if c.track_id == 2)
    assert change.kind == "LOST"
    assert change.frames[0] <= min(i for _, i in lost)
    assert change.frames[1] >= max(i for _, i in lost)
    assert "camera+lidar had it" in change.why
    assert str(change).startswith("LOST car #2 ")
    assert change.xy_m == pytest.approx((26.0, 0.01 * change.frames[0]))


def test_alarms_and_switches_are_told_apart(runs: Path) -> None:
    found = compare(runs / "base", runs / "alarms", "")
    kinds = {c.kind: c for c in found.objects}
    assert (kinds["NEW FALSE ALARM"].frames, kinds["NEW FALSE ALARM"].num_frames) == ((30, 49), 20)
    assert kinds["NEW SWITCH"].frames[0] >= 70
    assert all(30 <= frame.frame < 50 for frame in found.worst)


def test_without_a_policy_f1_and_mota_may_fall_by_the_tolerance(runs: Path) -> None:
    assert compare(runs / "base", runs / "worse").is_worse
    assert not compare(runs / "base", runs / "worse", tolerance=1.0).is_worse
    assert not compare(runs / "worse", runs / "base").is_worse


def test_other_logs_are_refused(runs: Path) -> None:
    with pytest.raises(MetricError, match="different logs can't be compared: base is 'log'"):
        compare(runs / "base", runs / "other")


def test_scores_by_other_rules_are_refused(runs: Path, tmp_path: Path) -> None:
    shutil.copytree(runs / "worse", tmp_path / "old")
    file = tmp_path / "old/scores.json"
    rows = json.loads(file.read_text(encoding="utf-8"))
    rows[0]["value"] = 0.123
    file.write_text(json.dumps(rows), encoding="utf-8")
    with pytest.raises(MetricError, match=r"f1 of vehicle .* is 0.123 in scores.json.*run fbench score"):
        compare(runs / "base", tmp_path / "old")


@pytest.mark.parametrize(
    ("policy", "state", "said"),
    [
        ('[[gate]]\nmetric = "f1"\nkind = "absolute"\ntolerance = 0.5\n', "passed", ""),
        ('[[gate]]\nmetric = "f1"\nkind = "relative"\ntolerance = 0.02\n', "failed", ""),
        ('[[gate]]\nmetric = "f1"\ntolerance = 1.0\nmin = 0.99\n', "failed", "less than 0.99"),
        ('[[gate]]\nmetric = "recall"\nslice = "range *"\n', "failed", ""),
        (
            '[[gate]]\nmetric = "f1"\ncondition = "fog*"\n',
            "failed",
            "no number fits the gate of f1, vehicle, all, fog*",
        ),
        ('[[gate]]\nmetric = "f1"\nslice = "range 0-10 m"\n', "failed", "range 0-10 m, or none has a value"),
        ('[budget]\nfaults = {LOG001 = 1}\n[[gate]]\nmetric = "f1"\ntolerance = 1.0', "failed", "2 faults LOG001"),
        ('[budget]\nmin_coverage = 0.5\n[[gate]]\nmetric = "f1"\ntolerance = 1.0', "passed", ""),
        ('[latency]\nmax_ratio = 2.0\n[[gate]]\nmetric = "f1"\ntolerance = 1.0', "failed", "1 repeat, at least 5"),
    ],
)
def test_rules_of_a_policy(runs: Path, policy: str, state: str, said: str) -> None:
    found = compare(runs / "base", runs / "worse", policy)
    assert found.state == state
    assert said in " ".join([*found.failures, *(r.reason for r in found.gating)])


def test_what_regresses_without_a_gate_is_in_the_headline(runs: Path) -> None:
    found = compare(runs / "base", runs / "worse", '[[gate]]\nmetric = "precision"\nkind = "absolute"\n')
    assert found.state == "passed"
    num = sum(r.verdict == "REGRESSED" for r in found.rows)
    assert found.headline == f"no regression of what gates; {num} without a gate REGRESSED"
    nothing = compare(runs / "base", runs / "noop", '[[gate]]\nmetric = "f1"\nslice = "range 0-10 m"\n')
    assert nothing.headline.startswith("FAILED: no number fits the gate of f1, vehicle, range 0-10 m, or none")


def test_a_clear_loss_in_too_few_stretches_says_so(tmp_path: Path) -> None:
    """Of 6 stretches the smallest p is 2/64, and twice that for two gates."""
    for name, missed in (("base", set()), ("head", {(i, i % 4) for i in range(60)})):
        write_drive(tmp_path / name, missed, seconds=6)
    f1 = compare(tmp_path / "base", tmp_path / "head", "").gating[0]
    assert f1.verdict == "INCONCLUSIVE"
    assert "is beyond the tolerance, but p = 0.062 after correction: 6 stretches or scenes are too few" in f1.reason
    assert f1.reason.endswith("are too few to show any change; 7 or more can")


def test_inconclusive_passes_or_fails_as_the_policy_says(runs: Path) -> None:
    gate = '[[gate]]\nmetric = "f1"\ntolerance = 0.0\n'
    assert compare(runs / "base", runs / "noise", gate).state == "inconclusive"
    assert compare(runs / "base", runs / "noise", f'inconclusive = "fail"\n{gate}').is_worse


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("versio = 1\n", r"gate.toml:1: 'versio(n' is missing|' isn't known)"),
        ("version = 1\nalpha = 2\n", "gate.toml:2: 'alpha'"),
        ('version = 1\n\n[[gate]]\nmetric = "f1"\n[[gate]]\nmetric = "mota"\ntolernce = 1\n',
         "gate.toml:7: 'gate.1.tolernce' isn't known; did you mean 'tolerance'"),
        ('version = 1\n[[gate]]\nmetric = "f11"\n', "gate.toml:3: 'gate.0.metric': unknown metric 'f11'; did you mean"),
        ('version = 1\n[budget]\nmin_coverage = "x"\n', "gate.toml:3: 'budget.min_coverage'"),
        ("version = 1\n[[gate]]\nkind = 'absolute'\n", "gate.toml:2: 'gate.0.metric' is missing"),
        (GATE + 'class_ = "car"\n', "gate.toml:4: 'gate.0.class_' isn't known; did you mean 'class'"),
        (GATE + 'min = 0.9\nmax = 0.1\n', "gate.toml:2: 'gate.0': no number is at least 0.9"),
        (GATE + '[[gate]]\nmetric = "f1"\n', "gate.toml:4: 'gate.1': is about the numbers"),
        ("version = 1\n[budget]\nfaults = {LOG01 = 0}\n", "gate.toml:3: 'budget.faults': unknown fault 'LOG01'"),
        (GATE + 'slice = "\\u0000"\n', "gate.toml:4: 'gate.0.slice': has characters that"),
        ("version = 1\n[[budget]]\nfailed_frames = 0\n", "gate.toml:2: 'budget'"),
        ("version = \n", "not TOML"),
        ("alpha = 0.1\nversion = true\n", "gate.toml:2: 'version': expected a whole number"),
        ("version = 1.0\n", "gate.toml:1: 'version': expected a whole number"),
    ],
)  # fmt: skip
def test_broken_policies_are_refused_with_file_line_and_key(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "gate.toml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=said):
        load_policy(tmp_path / "gate.toml")


def test_suites_are_paired_by_cell(runs: Path, tmp_path: Path) -> None:
    for side, second in (("one", "base"), ("two", "worse")):
        shutil.copytree(runs / "base", tmp_path / side / "a")
        shutil.copytree(runs / second, tmp_path / side / "b")
        cells = [{"run": "a"}, {"run": "b", "condition": "fog:3"}, {"log": "x", "state": "unfit", "reason": "no lidar"}]
        write_cells(tmp_path / side, cells)
    found = compare(tmp_path / "one", tmp_path / "two", "")
    own = [r for r in found.rows if (r.metric, r.class_, r.slice) == ("f1", "vehicle", "all") and r.base is not None]
    verdicts = {r.condition: r.verdict for r in own}
    assert verdicts == {"clear": "identical", "fog:3": "REGRESSED"}
    assert any("no lidar" in note for note in found.notes)


def test_a_cell_that_only_the_base_has_fails(runs: Path, tmp_path: Path) -> None:
    for side in ("one", "two"):
        shutil.copytree(runs / "base", tmp_path / side / "a")
    write_cells(tmp_path / "one", [{"run": "a"}, {"run": "a", "seed": 1}])
    write_cells(tmp_path / "two", [{"run": "a"}, {"state": "failed", "reason": "it broke", "seed": 1}])
    found = compare(tmp_path / "one", tmp_path / "two", "")
    assert found.is_worse
    assert "head has none (failed: it broke)" in found.failures[0]
    assert compare(tmp_path / "one", tmp_path / "two", "[budget]\nfailed_cells = 1\n").state == "identical"


@pytest.mark.parametrize(
    ("cells", "said"),
    [
        ([{"run": "../x"}], "isn't inside the suite"),
        ([{"run": "a"}, {"run": "a"}], "is there twice"),
        ([{"run": "nowhere"}], "no such run folder"),
        ([{"state": "failed", "reason": "it broke"}], "nothing to compare"),
    ],
)
def test_broken_suites_are_refused(runs: Path, tmp_path: Path, cells: list[dict[str, object]], said: str) -> None:
    shutil.copytree(runs / "base", tmp_path / "suite/a")
    write_cells(tmp_path / "suite", cells)
    with pytest.raises(FbenchError, match=said):
        compare(tmp_path / "suite", tmp_path / "suite")


def test_a_baseline_compares_as_the_run_does(runs: Path, tmp_path: Path) -> None:
    out = tmp_path / "baseline.json"
    done = accept(runs / "base", "first", out, by="Ada", at="2026-01-02")
    assert done.replaced is None
    assert out.stat().st_size < 100_000
    kept, whole = (compare(base, runs / "worse", "") for base in (out, runs / "base"))
    assert [r.verdict for r in kept.rows] == [r.verdict for r in whole.rows]
    assert row(kept, "f1") == row(whole, "f1")
    assert compare(out, runs / "noop", "").state == "identical"
    again = accept(runs / "base", "second", tmp_path / "two.json", by="Ada", at="2026-01-02")
    assert again.path.read_text(encoding="utf-8").replace("second", "first") == out.read_text(encoding="utf-8")
    assert accept(runs / "base", "again", out, "Ada", "2026").replaced == done.acceptance


@pytest.mark.parametrize("text", ["", "{}", '{"format": 1, "kind": "fbench baseline"}', "[1]"])
def test_what_is_no_baseline_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "b.json").write_text(text, encoding="utf-8")
    with pytest.raises(RunError, match="not a baseline"):
        load_baseline(tmp_path / "b.json")


def test_a_baseline_with_counts_beyond_all_bounds_is_refused(runs: Path, tmp_path: Path) -> None:
    accept(runs / "base", "first", tmp_path / "b.json", by="Ada", at="2026-01-02")
    content = json.loads((tmp_path / "b.json").read_text(encoding="utf-8"))
    content["cells"][0]["counts"][0]["counts"][0][0] = 10**30
    (tmp_path / "b.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(RunError, match="not a baseline"):
        load_baseline(tmp_path / "b.json")


def test_a_baseline_needs_a_reason(runs: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="say why"):
        accept(runs / "base", "  ", tmp_path / "b.json", "Ada", "2026")
