"""`fbench demo`, and the experiment behind it on small logs."""

import json
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from tests.city_log import SMALL_RIG
from tests.kept_cities import shared_cities

from fbench.api.replays import short_name
from fbench.api.suites.cells import CellResult
from fbench.api.suites.logs import Drive
from fbench.api.suites.suite import SuitePipeline
from fbench.cli.demo import make_experiment, run_experiment
from fbench.cli.experiment import DISTURBANCES, Experiment, results_of, row_name, uses
from fbench.datasets.city.spec import CitySpec, condition
from fbench.datasets.importing.run import claim
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.runs.folder import Run

MEASURED = {"timings.parquet", "latency.json", "host.json", "cell.json", "report.html", "latency.md"}


@pytest.fixture(autouse=True)
def cities():
    with shared_cities():
        yield


def small(folder, *pipelines, conditions=("clear", "fog"), settings=None, **fields):
    """Drives of a third of a second, without cameras."""
    drives = tuple(
        Drive(CitySpec("highway", condition(name), 0.3, 1, SMALL_RIG), folder / "logs" / f"{name}.mcap")
        for name in conditions
    )
    rows = tuple(SuitePipeline(short_name(name), name, tuple((settings or {}).get(name, ()))) for name in pipelines)
    return Experiment(drives, rows, folder, "fbench demo", **fields)


def files(folder):
    found = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in MEASURED)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_short_version_is_both_worlds_in_the_weathers_that_cost_most():
    what = make_experiment(Path("demo"), None, None, None)
    assert what.conditions == ["clear", "dense-fog", "night"]
    assert [drive.name for drive in what.drives][:2] == ["urban-clear-202", "urban-dense-fog-202"]
    assert len({drive.spec.log_id for drive in what.drives}) == len(what.drives) == 15
    assert len({drive.scene for drive in what.drives}) == 5  # so that there are intervals
    assert what.disturbances == []
    assert what.drives[0].log == Path("demo/city.mcap")
    assert what.drives[1].log == Path("demo/logs/urban-dense-fog-202.mcap")
    assert what.drives[0].spec.rig.names == ("camera", "lidar", "radar")
    with_media = [cell.drive for cell in what.cells() if not cell.request.no_media]
    assert with_media == [what.drives[0]] * len(what.pipelines)  # the one that the report shows
    assert what.command == "fbench demo"


LEARNT = "seeds that fbench's own camera detector learned from"


def test_drives_have_the_sensors_that_are_asked_for():
    with_pair = make_experiment(Path("demo"), "dev", None, 1, ("*",))
    assert {"stereo_left", "stereo_right", "camera", "lidar", "radar"} == set(with_pair.drives[0].spec.rig.names)
    assert with_pair.command == "fbench demo --split dev --num-seeds 1 --sensors '*'"
    assert make_experiment(Path("demo"), "dev", None, 1).drives == with_pair.drives
    without = make_experiment(Path("demo"), "dev", None, 1, ("camera", "lidar", "radar"))
    assert set(without.drives[0].spec.rig.names) == {"camera", "lidar", "radar"}
    for stereo in (row for row in without.pipelines if row.name in ("early3d-stereo", "late2d-stereo")):
        assert stereo.settings == ("stereo_pair=on",)  # no settings of cameras that aren't there
    with pytest.raises(ConfigError, match="sonar"):
        make_experiment(Path("demo"), None, None, None, ("sonar",))


@pytest.mark.parametrize("split", [None, "dev", "test"])
def test_the_detector_learnt_from_no_scene_of_an_experiment(split):
    assert LEARNT not in dict(results_of(make_experiment(Path("demo"), split, None, None), []).facts)


def test_results_say_which_scenes_the_detector_learnt_from():
    what = small(Path("demo"))
    drives = tuple(
        replace(drive, spec=replace(drive.spec, seed=seed)) for seed in (370, 1, 302) for drive in what.drives
    )
    assert dict(results_of(replace(what, drives=drives), []).facts)[LEARNT] == "302, 370"


def test_full_suite_has_all_scenes_for_each_seed_of_the_split():
    what = make_experiment(Path("full"), "test", None, 2)
    assert {drive.spec.seed for drive in what.drives} == {9001, 9002}
    assert {drive.spec.seconds for drive in what.drives} == {10.0}
    assert len(what.drives) == 28
    assert what.conditions[-3:] == ["traffic+fog", "heavy-rain", "dense-fog"]
    assert what.command == "fbench demo --split test --num-seeds 2"
    names = {row_name(row) for row in what.pipelines}
    assert {"late3d", "thesis/late3d", "early3d-stereo", "late2d-stereo", "thesis/late2d-stereo"} <= names
    assert "thesis/late3d-filter" in names
    assert not any("thesis" in row.base for row in make_experiment(Path("demo"), None, None, None).pipelines)


def test_rows_without_stereo_dont_get_the_pair_and_those_with_it_look_into_one_image():
    what = make_experiment(Path("full"), "test", None, 1)
    assert what.scoring.cameras == ("camera",)
    for row in what.pipelines:
        if "stereo" not in row.name:
            assert row.sensors
            assert not any("stereo" in name for name in row.sensors)
        elif row.name != "stereo3d":
            assert {"stereo_left.weights=none", "stereo_right.weights=none"} <= set(row.settings)
    assert {"camera", "stereo_left"} <= set(what.drives[0].spec.rig.names)


def test_drives_are_disturbed_that_give_intervals_and_only_for_pipelines_that_use_the_sensor():
    what = make_experiment(Path("full"), "test", None, None)
    assert len({drive.scene for drive in what.disturbed}) == 6
    assert {drive.condition for drive in what.disturbed} == {"clear"}
    assert all(drive in what.drives for drive in what.disturbed)
    assert [drive.name for drive in what.rendered][:2] == ["urban-dusk-9001", "highway-dusk-9001"]
    assert {drive.spec.seconds for drive in what.rendered} == {2.0}
    assert what.disturbances[:4] == ["clear", "dusk", "low-sun", "glare"]
    lost = [cell for cell in what.cells() if cell.disturbance == "lidar lost"]
    names = {cell.name for cell in lost}
    assert {"lidar2d", "thesis/late3d", "early3d-stereo", "late2d-stereo"} <= names
    assert not {"camera2d", "radar3d", "stereo3d"} & names
    assert {cell.request.condition for cell in lost} == {"loss.lidar:100%@1s-"}
    assert {cell.request.to for cell in lost} == {"2"}
    cells = what.cells()
    assert len({cell.request.out for cell in cells}) == len(cells)
    named = what.name_cells([(cell, CellResult(cell.request, "there")) for cell in cells])
    assert len({(cell.log, cell.pipeline, cell.condition) for cell, _ in named}) == len(cells)
    stereo = next(row for row in what.pipelines if row.name == "stereo3d")
    assert [name for name, text in DISTURBANCES.items() if uses(stereo, text)] == [
        "glare",
        "camera lost",
        "camera away",
    ]


def test_rows_whose_sensors_the_drives_lack_are_left_out():
    what = make_experiment(Path("suite"), "dev", None, 1, ["stereo*", "lidar"])
    names = {row.name: row.sensors for row in what.pipelines}
    assert "camera2d" not in names  # it would take the pair's images
    assert names["lidar3d"] == ("lidar",)
    assert names["stereo3d"] == ("stereo_left", "stereo_right")
    assert "camera2d (the drives are without camera, see --sensors)" in what.left_out
    assert what.scoring.cameras == ()


def test_drives_too_short_to_lose_a_sensor_are_not_disturbed():
    what = make_experiment(Path("suite"), "dev", 1.0, None)
    assert (what.disturbances, what.disturbed, what.rendered) == ([], (), ())
    assert what.left_out == ("other disturbances (they need drives of 2 s)",)
    assert not make_experiment(Path("suite"), "dev", 2.0, None).left_out


@pytest.mark.parametrize(("seconds", "text"), [(3.0, "3"), (0.3, "0.3"), (1234.5678, "1234.5678")])
def test_the_command_does_the_same_again(seconds, text):
    assert make_experiment(Path("demo"), None, seconds, None).command == f"fbench demo --seconds {text}"


def test_pipelines_are_those_that_need_nothing_beside_the_log():
    names = [row.base for row in make_experiment(Path("demo"), None, None, None).pipelines]
    assert {"camera2d", "late3d", "lidar3d", "radar3d"} <= set(names)
    assert not {"exec", "recorded"} & set(names)


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (("--num-seeds", "1"), "--num-seeds is only for the full suite"),
        (("--seconds", "0.01"), "--seconds 0.01"),
        (("--seconds", "0"), "--seconds 0"),
        (("--split", "train"), "train"),
        (("--jobs", "0"), "--jobs"),
        (("-o", "taken"), "taken: can't be written"),
    ],
)
def test_wrong_use(fbench, arguments, error):
    Path("taken").write_text("a file")
    result = fbench("demo", *arguments)
    assert result.code == 2
    assert error in result.err


def test_a_log_of_somebody_else_is_not_replaced(fbench):
    log = Path("mine/city.mcap")
    log.parent.mkdir()
    log.write_bytes(b"a recording of mine")
    result = fbench("demo", "-o", "mine")
    assert (result.code, log.read_bytes()) == (2, b"a recording of mine")
    assert result.err.startswith("fbench: mine/city.mcap: exists already, and wasn't simulated here; choose another")
    assert sorted(path.name for path in log.parent.iterdir()) == ["city.mcap"]


def test_a_second_demo_in_a_folder_waits_for_the_first(tmp_path, capsys):
    said = ""
    with ThreadPoolExecutor(1) as pool:
        with claim(tmp_path / "demo", lambda: None):
            second = pool.submit(run_experiment, small(tmp_path, conditions=()), 1)
            while not said:
                said = capsys.readouterr().out
                time.sleep(0.01)
            assert said == "waiting for another fbench demo in this folder\n"
            assert not list(tmp_path.glob("results.*"))
        assert second.result(60) == 0
    assert (tmp_path / "results.md").is_file()


@pytest.mark.slow
def test_experiment_is_repeated_in_no_time_and_equal_for_any_number_of_workers(fbench, capsys):
    assert run_experiment(small(Path("one"), "lidar3d", "radar3d"), 1) == 0
    text = capsys.readouterr().out
    for line in ("logs: 2 (2 simulated, 0 there already)", "runs: 4 of 4 (4 replayed, 0 there already)",
                 "F1 % worst weather", "results: one/results.md", "report: one/report.html"):  # fmt: skip
        assert line in text
    assert len(text.splitlines()) <= 12
    page = Path("one/results.md").read_text()
    for line in ("table 9.4), %", "table 9.5), %", "table 9.4), road and sidewalk only, %",
                 "- frames: 6, each through 2 pipelines; 100.0 % of outputs had truth"):  # fmt: skip
        assert line in page
    first = files(Path("one"))
    assert run_experiment(small(Path("one"), "lidar3d", "radar3d"), 2) == 0
    text = capsys.readouterr().out
    assert "logs: 2 (0 simulated, 2 there already)" in text
    assert "runs: 4 of 4 (0 replayed, 4 there already)" in text
    assert files(Path("one")) == first
    assert run_experiment(small(Path("two"), "lidar3d", "radar3d"), 2) == 0
    assert files(Path("two")) == first

    results = json.loads(Path("one/results.json").read_text())
    assert [run["run"] for run in results["runs"]][:2] == ["highway-clear-1/lidar3d", "highway-clear-1/radar3d"]
    fog = next(row for row in results["tables"]["robustness"] if (row["name"], row["space"]) == ("lidar3d", "3D"))
    assert fog["published"] == -0.2234
    assert Run(Path("one/highway-clear-1/lidar3d")).media
    assert not Run(Path("one/highway-fog-1/lidar3d")).media


@pytest.mark.slow
def test_results_of_an_interrupted_experiment_are_those_of_another(fbench, monkeypatch):
    @contextmanager
    def interrupt_after_one(what):
        def progress(done, total):
            if done == 1:
                raise KeyboardInterrupt

        yield progress

    assert run_experiment(small(Path("one"), "radar3d"), 1) == 0
    with monkeypatch.context() as patch:
        patch.setattr("fbench.cli.demo.replay_progress", interrupt_after_one)
        with pytest.raises(KeyboardInterrupt):
            run_experiment(small(Path("two"), "radar3d"), 1)
    assert not Path("two/results.md").exists()
    assert list(Path("two").glob("*/*/manifest.json"))
    assert run_experiment(small(Path("two"), "radar3d"), 1) == 0
    assert Path("two/results.md").read_bytes() == Path("one/results.md").read_bytes()
    assert files(Path("two")) == files(Path("one"))


@pytest.mark.slow
def test_pipelines_without_their_sensors_are_left_out(fbench, capsys):
    what = small(Path("demo"), "radar3d", "stereo3d", "thesis/early3d-stereo", conditions=("clear",))
    assert run_experiment(what, 1) == 0
    said = capsys.readouterr().out
    assert "runs: 1 of 1" in said
    absent = "the drives are without stereo_left, stereo_right, see --sensors; log '"
    assert f"left out: stereo3d ({absent}" in said.replace("camera, ", "")
    assert f"left out: thesis/early3d-stereo ({absent}" in said.replace("camera, ", "")
    assert "failed" not in said


@pytest.mark.slow
def test_what_fails_is_shown_and_the_rest_goes_on(fbench, capsys):
    settings = {"lidar3d": ["lidar.cluster.eps_m=-1"]}
    names = ("camera2d", "lidar3d", "radar3d", "thesis/radar3d")  # the last has parameters of a camera that it ignores
    what = small(Path("demo"), *names, conditions=("clear",), settings=settings)
    assert run_experiment(what, 1) == 4
    assert json.loads(Path("demo/results.json").read_text())["facts"]["camera detector"] == "none"
    captured = capsys.readouterr()
    assert "failed: lidar3d on highway-clear-1: " in captured.out
    assert "runs: 2 of 3" in captured.out
    assert "\nradar3d         3D" in captured.out
    log = Path("demo/logs/clear.mcap")
    whole = log.read_bytes()
    log.write_bytes(whole[: len(whole) // 2])
    run_experiment(what, 1)
    assert "logs: 1 (1 simulated" in capsys.readouterr().out
    assert log.read_bytes() == whole
