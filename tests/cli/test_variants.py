"""Variants on the command line."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from fbench.api.suites.logs import Drive
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.api.suites.suite import SuitePipeline
from fbench.cli.experiment import Experiment
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

FAR = 'name = "far-cars"\ntitle = "looks far"\nbase = "lidar3d"\nsensors = ["lidar"]\n[parameters]\nmin_score = 0.25\n'


@pytest.fixture
def far(tmp_path):
    path = tmp_path / "variants" / "far.toml"
    path.parent.mkdir()
    path.write_text(FAR)
    return path


def manifest(folder):
    return json.loads(Path(folder, "manifest.json").read_text())


def test_a_run_of_a_variant(fbench, log, far):
    result = fbench("replay", log, "-p", far, "--json")
    assert result.code == 0, result.err
    assert Path(result.json()["run"]) == Path("runs/car-far-cars")
    found = manifest("runs/car-far-cars")
    assert found["pipeline"] == "far-cars"
    assert found["variant"] == {"name": "far-cars", "title": "looks far", "base": "lidar3d", "sets": ["min_score"]}
    assert found["frames"]["sensors"] == ["lidar"]
    fbench("replay", log, "-p", "lidar3d", "--set", "min_score=0.25")
    base = manifest("runs/car-lidar3d")
    assert (base["variant"], base["frames"]["sensors"]) == (None, [])
    assert found["parameters"] == base["parameters"]
    assert found["digest"] == base["digest"]


def test_a_log_that_does_not_fit_a_variant(fbench, log, far):
    far.write_text(FAR.replace("lidar3d", "stereo3d"))
    result = fbench("replay", log, "-p", far, "--sensors", "lidar")
    assert result.code == 3
    assert "a stereo pair needs two cameras" in result.err
    assert result.err.rstrip().endswith("far-cars is a variant of stereo3d [CFG001]")


def test_a_summary_says_how_much_was_found(fbench, log, far):
    result = fbench("replay", log, "-p", far, "-o", "run")
    found = fbench("replay", log, "-p", far, "-o", "again", "--json").json()
    assert found["manifest"]["num_frames"] == 6
    boxes = pq.read_table("run/detections.parquet").num_rows
    ids = set(pq.read_table("run/tracks.parquet")["track_id"].to_pylist())
    assert f"found: {boxes} detections, {len(ids)} track" in result.out
    assert boxes > 1


def test_options_go_on_top(fbench, log, far):
    assert fbench("replay", log, "-p", far, "--set", "min_score=0.5", "--sensors", "!radar", "-o", "run").code == 0
    found = manifest("run")
    assert found["parameters"]["min_score"] == 0.5
    assert found["variant"]["sets"] == ["min_score"]
    assert found["frames"]["sensors"] == ["!radar"]


def test_detection_in_every_other_frame(fbench, log, far):
    far.write_text(FAR.replace("[parameters]", "detect_every = 2\n[parameters]"))
    assert fbench("replay", log, "-p", far, "-o", "run").code == 0
    assert manifest("run")["parameters"]["detect_every"] == 2
    assert manifest("run")["variant"]["sets"] == ["detect_every", "min_score"]
    assert fbench("replay", log, "-p", far, "--detect-every", "3", "-o", "thirds").code == 0
    assert manifest("thirds")["parameters"]["detect_every"] == 3
    far.write_text(
        FAR.replace("lidar3d", "recorded").replace("min_score = 0.25", "").replace("[p", "detect_every = 2\n[p")
    )
    result = fbench("replay", log, "-p", far)
    assert (result.code, "unknown parameter 'detect_every'" in result.err) == (2, True)


def test_a_redacted_run_keeps_the_name_alone(fbench, log, far):
    assert fbench("replay", log, "-p", far, "--redact", "-o", "run").code == 0
    assert manifest("run")["variant"] == {"name": "far-cars", "title": "", "base": "lidar3d", "sets": ["min_score"]}


@pytest.mark.slow
def test_a_built_in_variant_is_replayed_verified_and_compared(fbench, log, circumstances, in_this_process):
    circumstances("hash seed")
    assert fbench("replay", log, "-p", "thesis/lidar3d").code == 0
    assert manifest("runs/car-thesis-lidar3d")["pipeline"] == "thesis/lidar3d"
    assert manifest("runs/car-thesis-lidar3d")["variant"]["base"] == "plain3d"
    assert fbench("replay", log, "-p", "lidar3d").code == 0
    result = fbench("compare", "runs/car-thesis-lidar3d", "runs/car-lidar3d")
    assert result.code in (0, 1)
    assert "pipeline: thesis/lidar3d -> lidar3d" in result.out + result.err
    assert fbench("report", "runs/car-thesis-lidar3d", "-o", "report.html").code == 0
    assert "thesis/lidar3d" in Path("report.html").read_text()
    in_this_process()
    assert fbench("verify", log, "-p", "thesis/lidar3d", "--quick").code == 0


@pytest.mark.slow
def test_verify_from_another_folder(fbench, log, far, monkeypatch, circumstances):
    """Files are found though the replays run elsewhere, and each gets the sensors of the variant."""
    circumstances("other time zone, locale and folder")
    monkeypatch.chdir(far.parent)
    result = fbench("verify", log, "-p", "far.toml", "--quick", "--keep", "kept")
    assert result.code == 0, result.out + result.err
    runs = [manifest(path.parent) for path in Path("kept").glob("*/manifest.json")]
    assert {(tuple(run["frames"]["sensors"]), run["parameters"]["min_score"]) for run in runs} == {(("lidar",), 0.25)}


def test_check_of_a_log_with_a_variant(fbench, log, far):
    assert fbench("log", "check", log, "-p", far).code == 0
    assert fbench("log", "check", log, "-p", far.parent / "absent.toml").code == 2
    far.write_text(FAR.replace('["lidar"]', '["lidra"]'))
    assert "--sensors lidra: fits no sensor" in fbench("log", "check", log, "-p", far).err
    assert fbench("log", "check", log, "-p", far, "--sensors", "lidar").code == 0


def test_a_variant_of_track_takes_results(fbench, log, far):
    far.write_text('name = "slow"\nbase = "track"\ndetect_every = 2\n')
    boxes = far.parent / "boxes.csv"
    boxes.write_text("frame,x,y,z,length,width,height,yaw,label,score\n0,12,0,0.75,4,1.8,1.5,0,car,0.9\n")
    result = fbench("replay", log, "-p", far, "--detections", boxes, "-o", "run")
    assert "can't be used with them" not in result.err
    assert fbench("replay", log, "-p", "thesis/lidar3d", "--detections", boxes).code == 2


@pytest.mark.slow
def test_cells_of_a_suite_and_their_folders(log, far, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    cells = [
        ReplayRequest(LogRequest(log, config=NO_CONFIG), str(far), out=Path("runs/far"), overwrite=True, no_media=True)
    ]
    assert [result.state for result in run_suite(cells, RunOptions(1))] == ["replayed"]
    assert [result.state for result in run_suite(cells, RunOptions(1))] == ["there"]
    far.write_text(FAR.replace('["lidar"]', '["lid*"]'))
    assert [result.state for result in run_suite(cells, RunOptions(1))] == ["replayed"]
    far.write_text(FAR.replace("0.25", "0.5"))
    assert [result.state for result in run_suite(cells, RunOptions(1))] == ["replayed"]


def test_folders_of_an_experiment(tmp_path):
    from fbench.datasets.city.spec import CitySpec

    drive = Drive(CitySpec("urban"), tmp_path / "a.mcap")
    row = SuitePipeline("thesis-late3d", "thesis/late3d")
    (cell,) = Experiment((drive,), (row,), tmp_path, "fbench demo").cells()
    assert cell.request.out == tmp_path / drive.name / "thesis-late3d"


def test_list_of_pipelines_and_parameters_of_a_variant(fbench, far):
    listed = " ".join(fbench("plugins", "pipelines").out.split())
    assert "thesis/late3d fbench.pipelines.variants.thesis, a variant of plain3d" in listed
    assert "thesis" not in fbench("plugins", "datasets").out
    text = fbench("plugins", "pipelines", far).out
    assert text.startswith("looks far\nbase: lidar3d\nsensors: lidar\n")
    rows = [line.split() for line in text.splitlines()]
    defaults = pipeline_parameters("lidar3d", [])
    assert ["min_score", "0.25", str(defaults["min_score"])] in [row[:3] for row in rows]
    assert ["min_range_m"] not in [row[:1] for row in rows]
    assert ["lidar.cluster.eps_m", str(defaults["lidar.cluster.eps_m"]), "Radius", "[m]."] in rows
    assert "base: plain3d" in fbench("plugins", "pipelines", "thesis/late3d").out
    assert fbench("plugins", "pipelines", "thesis/late4d").code == 2
    assert fbench("plugins", "datasets", far).code == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("text", "message"),
    [
        (FAR.replace("lidar3d", "lidar4d"), "'base': unknown pipeline 'lidar4d'; did you mean 'lidar3d'?"),
        (FAR + "min_skore = 1", "unknown parameter 'min_skore'; did you mean 'min_score'?"),
        (FAR + "lidar.cluster.eps_m = 'wide'", "lidar.cluster.eps_m=wide: expected float"),
        ("[", "Invalid"),
    ],
)
def test_one_line_for_what_is_wrong(fbench, log, far, in_this_process, text, message):
    in_this_process()
    far.write_text(text)
    for command in (("replay", log, "-p"), ("verify", log, "-p"), ("plugins", "pipelines")):
        result = fbench(*command, far)
        assert result.code == 2
        assert result.err.startswith(f"fbench: {far}: ")
        assert message in result.err
        assert len(result.err.splitlines()) == 1
    assert not Path("runs").exists()


def test_sensors_of_a_variant_that_the_log_lacks(fbench, log, far):
    far.write_text(FAR.replace('["lidar"]', '["lidra"]'))
    result = fbench("replay", log, "-p", far)
    assert result.code == 2
    assert "--sensors lidra: fits no sensor; did you mean 'lidar'?" in result.err
