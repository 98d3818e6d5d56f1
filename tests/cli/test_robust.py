"""`fbench robust` on a small log of the city, without cameras."""

from pathlib import Path

import pytest
from tests.city_log import write_city_log

from fbench.api.robust import SUITES, fitting_settings, parse_severities
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.scores import load_scores

CELLS = ("--condition", "loss", "--condition", "delay.lidar:3", "--severity", "1,5")

FAILS = """
class Fails:
    version, kinds, levels = 1, ("radar",), {"x": (1, 2, 3, 4, 5)}

    def disturb(self, message, level, site):
        if site.history:
            raise ValueError("no more")
        return [message]
"""


@pytest.fixture(scope="module")
def city(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("robust") / "city.mcap"
    write_city_log(path, seconds=1.5)
    return path


def kept(folder: Path) -> dict[str, bytes]:
    """What doesn't depend on the machine."""
    names = ("results.json", "results.md", "manifest.json", "frames.parquet", "tracks.parquet", "scores.json")
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*")) if path.name in names
    }  # fmt: skip


def value(rows, name, column):
    return next(row["value"] for row in rows if (row["name"], row["column"]) == (name, column))


@pytest.mark.slow
def test_the_matrix_is_that_of_single_replays_and_comes_back(fbench, city):
    result = fbench("robust", city, "-p", "lidar3d,radar3d", *CELLS, "-o", "suite", "--jobs", 2, "--json")
    assert (result.code, result.err) == (0, "")
    content = result.json()
    assert [(row["pipeline"], row["condition"], row["severity"]) for row in content["runs"]] == [
        (pipeline, *cell)
        for pipeline in ("lidar3d", "radar3d")
        for cell in (("clear", ""), ("loss", "1"), ("loss", "5"), ("delay.lidar:3", ""))
    ]
    assert fbench("replay", city, "-p", "lidar3d", "--condition", "loss:5", "-o", "one").code == 0
    f1 = next(row.value for row in load_scores(Path("one/scores.json")) if row.metric == "f1")
    assert value(content["tables"]["robustness_f1"], "loss 5", "lidar3d") == pytest.approx(f1)
    # A LiDAR that comes 100 ms late is in no frame; the radar doesn't care.
    assert value(content["tables"]["robustness_f1_change"], "delay.lidar:3", "lidar3d") == -1
    assert value(content["tables"]["robustness_f1_change"], "delay.lidar:3", "radar3d") == 0

    before = kept(Path("suite"))
    again = fbench("robust", city, "-p", "lidar3d,radar3d", *CELLS, "-o", "suite", "--jobs", 1)
    assert "runs: 8 of 8 (0 replayed, 8 there already)" in again.out
    assert kept(Path("suite")) == before
    other = fbench("robust", city, "-p", "radar3d", *CELLS[:2], "--severity", "1", "--seed", 1, "-o", "suite")
    assert "(2 replayed, 0 there already)" in other.out


@pytest.mark.slow
def test_what_does_not_fit_the_log_is_left_out_of_a_suite_and_said(fbench, city):
    result = fbench("robust", city, "-p", "radar3d", "--suite", "faults", "--severity", "3", "-o", "suite", "--json")
    assert result.code == 0
    problems = result.json()["problems"]
    assert any(line.startswith("left out: dropout.camera on city: ") for line in problems)
    conditions = {row["condition"] for row in result.json()["runs"]}
    assert {"clear", "dropout.radar", "radar.ghost"} <= conditions
    assert "camera.crash" not in conditions


@pytest.mark.slow
def test_a_condition_that_fails_never_counts_as_clear_weather(fbench, city):
    """Defect 8: elsewhere, what a corruption raises is caught, and clean data is scored."""
    Path("mine.py").write_text(FAILS)
    own = ("--condition", "mine.py:Fails:2", "--condition", "radar.shift:2")
    result = fbench("robust", city, "-p", "radar3d", *own, "--jobs", 1, "-o", "suite", "--json")
    assert (result.code, result.err) == (4, "")
    content, why = result.json(), "condition 'mine.py:Fails' failed: ValueError: no more (mine.py:7)"
    assert content["problems"] == [f"failed: mine.py:Fails:2 of radar3d on city: {why}"]
    rows = {row["name"]: row for row in content["tables"]["robustness_f1"]}
    assert (rows["mine.py:Fails:2"]["value"], rows["mine.py:Fails:2"]["reason"]) == (None, f"failed on city: {why}")
    assert rows["radar.shift:2"]["value"] is not None
    assert [run["digest"] is None for run in content["runs"]] == [False, True, False]


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("--condition", "fgo"), "did you mean 'fog'"),
        (("--condition", "fog:7"), "expected a severity of 0 to 5"),
        (("--condition", "dropout.camera"), "the log has no such sensor"),
        (("--condition", "loss:2@100s-110s"), "begins after the log"),
        (("--severity", "0-5"), "expected severities from 1 to 5"),
        (("--severity", "5-1"), "expected severities from 1 to 5"),
        (("--baseline", "late3d"), "isn't among the pipelines"),
        (("--seed", "-1"), "expected 0 to 2^63 - 1"),
    ],
)
def test_wrong_options_cost_one_line_and_nothing_runs(fbench, city, arguments, text):
    result = fbench("robust", city, "-p", "radar3d", *arguments, "-o", "suite")
    assert result.code == 2
    assert len(result.err.splitlines()) == 1
    assert text in result.err
    assert not list(Path("suite").rglob("manifest.json")) if Path("suite").exists() else True


def test_a_log_that_cannot_be_read_costs_one_line_and_nothing_runs(fbench, city):
    result = fbench("robust", city, "nowhere.mcap", "-p", "radar3d", "-o", "suite")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "nowhere.mcap: can't be read (No such file or directory)" in result.err
    assert not Path("suite").exists()


def test_results_name_every_option_that_changes_them(fbench, city):
    own = ("--condition", "delay.radar:1", "--frames", ":2", "--set", "radar.max_range_m=60", "--all-around")
    result = fbench("robust", city, "-p", "radar3d", *own, "--range-m", 40, "-o", "suite", "--jobs", 1, "--json")
    assert result.code == 0, result.err
    assert dict(result.json()["facts"])["command"] == (
        "fbench robust city.mcap -p radar3d --condition delay.radar:1 --severity 1-5 --seed 0 "
        "--set radar.max_range_m=60 --frames :2 --range-m 40.0 --all-around"
    )


def test_settings_go_to_the_pipelines_that_have_them():
    found = fitting_settings(["lidar3d", "radar3d", "late3d"], ["lidar.judge=rules", "camera.weights=none"])
    both = ["lidar.judge=rules", "camera.weights=none"]
    assert found == {"lidar3d": both[:1], "radar3d": [], "late3d": both}
    # A parameter of a sensor: only a log tells whether it is there.
    assert fitting_settings(["lidar3d"], ["front.max_range_m=30"]) == {"lidar3d": ["front.max_range_m=30"]}
    with pytest.raises(ConfigError, match=r"lidar\.jugde"):
        fitting_settings(["lidar3d", "plain3d"], ["lidar.jugde=rules"])


def test_severities():
    assert parse_severities("1-5") == ("1", "2", "3", "4", "5")
    assert parse_severities("5,1, 3") == ("1", "3", "5")
    with pytest.raises(ConfigError):
        parse_severities("")


@pytest.mark.parametrize("name", sorted({name for names in SUITES.values() for name in names}))
def test_suites_name_conditions_that_exist(name):
    assert parse_conditions(name)
