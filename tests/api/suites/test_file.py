"""Suite files: the cells that they mean, and where they are wrong."""

import json
import os
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from tests.cli.conftest import write_log

from fbench.api.suites.contents import Contents
from fbench.api.suites.file import SuiteText
from fbench.api.suites.plan import make_suite, read_suite
from fbench.api.suites.runner import group_of
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.metadata import REGIONS, Region, regions_text
from fbench.replay.engine.latency_profile import REST, LatencyProfile, StageModel
from fbench.replay.formats.documents import find_line
from fbench.replay.logs.containers.mcap.records import MAGIC as EMPTY  # of a log that lost all that follows

GOOD = """
version = 1
title = "weathers"
conditions = ["clear", "fog", "dropout.lidar:2"]
severities = [1, 5]
rates = ["max", "2"]
seeds = [0, 7]

[[logs]]
simulate = ["urban", "highway"]
condition = "night"
seconds = 2.0
seed = 3

[pipelines.late3d]

[pipelines.late_wide]
base = "late3d"
set = ["lidar.max_range_m=60"]
sensors = ["lidar", "radar"]
"""


def suite_of(content: str, folder: Path):
    return make_suite(SuiteText(content.encode(), "suite.toml"), folder, Path("out"))


def test_cells_are_the_product_of_all_and_clear_weather_is_not_repeated_for_seeds(tmp_path):
    suite = suite_of(GOOD, tmp_path)
    cells = suite.cells()
    # Two logs, two pipelines, two rates; clear once, three disturbances for each of two seeds.
    assert len(cells) == 2 * 2 * 2 * (1 + 3 * 2)
    assert {cell.condition for cell in cells} == {"clear", "fog:1", "fog:5", "dropout.lidar:2"}
    assert {cell.log for cell in cells} == {"urban-night-3", "highway-night-3"}
    assert len({cell.request.out for cell in cells}) == len(cells)
    assert all(cell.request.out.is_relative_to("out/runs") for cell in cells)
    wide = next(cell for cell in cells if (cell.pipeline, cell.condition, cell.seed) == ("late_wide", "fog:5", 7))
    request = wide.request
    assert (request.pipeline, list(request.settings)) == ("late3d", ["lidar.max_range_m=60"])
    assert (list(request.sensors), request.condition, request.seed) == (["lidar", "radar"], "fog:5", 7)
    assert request.log.path == Path("out/logs/urban-night-3.mcap")


def test_latency_is_for_all_cells_and_decides_what_they_are_made_of(tmp_path):
    (tmp_path / "a.mcap").write_bytes(EMPTY)
    content = 'version = 1\nlogs = ["a.mcap"]\npipelines = ["lidar3d"]\nrates = ["1", "2"]\n[replay]\n'
    timed = [cell.request for cell in suite_of(f'{content}latency = "fixed:80ms"\noverload = "skip"', tmp_path).cells()]
    assert [(one.latency, one.overload, one.rate) for one in timed] == [("fixed:80ms", "skip", r) for r in ("1", "2")]
    plain = [cell.request for cell in suite_of(content, tmp_path).cells()]
    contents = Contents()
    keys = [json.dumps(contents.of(one), sort_keys=True, default=str) for one in (*plain, *timed)]
    assert keys[0] == keys[1]  # a pace changes nothing in lockstep
    assert len(set(keys)) == 3
    assert contents.of(replace(timed[0], latency="measured")) is None


def test_a_profile_of_latency_counts_by_what_is_in_it(tmp_path):
    (tmp_path / "a.mcap").write_bytes(EMPTY)
    for folder, base_ns in (("slow", 80_000_000), ("also", 80_000_000), ("fast", 20_000_000)):
        (tmp_path / folder).mkdir()
        model = StageModel(stage=REST, base_ns=base_ns, ps_per_point=0, ps_per_box=0, ps_per_pixel=0)
        facts = {"pipeline": "lidar3d", "log": "a", "repeats": 1, "host": {}}
        recorded = LatencyProfile(stages=[model], residuals_ns=[[0]], **facts)
        (tmp_path / folder / "orin.json").write_text(recorded.model_dump_json())
    content = 'version = 1\nlogs = ["a.mcap"]\npipelines = ["lidar3d"]\n[replay]\nlatency = "profile:'
    of = {
        folder: [Contents().of(cell.request) for cell in suite_of(f'{content}{folder}/orin.json"', tmp_path).cells()]
        for folder in ("slow", "also", "fast")
    }
    assert of["slow"] == of["also"] != of["fast"]
    with pytest.raises(ConfigError, match=r"suite.toml:5: 'replay.latency': .*none.json: no such file"):
        suite_of(f'{content}none.json"', tmp_path)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ('latency = "80ms"', "suite.toml:6: 'replay.latency': 80ms: expected 'measured', a time"),
        ('overload = "skip"', "suite.toml:6: 'replay.overload': skip: is about --latency, which is missing"),
        ('latency = "measured"\noverload = "fifo:0"', "suite.toml:7: 'replay.overload': fifo:0: expected"),
    ],
)
def test_a_latency_that_makes_no_sense(tmp_path, line, found):
    (tmp_path / "a.mcap").write_bytes(EMPTY)
    with pytest.raises(ConfigError) as error:
        suite_of(f'version = 1\nlogs = ["a.mcap"]\npipelines = ["lidar3d"]\n\n[replay]\n{line}', tmp_path)
    assert str(error.value).startswith(found)


def test_cells_that_need_the_same_messages_follow_each_other(tmp_path):
    groups = [group_of(cell.request) for cell in suite_of(GOOD, tmp_path).cells()]
    changes = sum(a != b for a, b in pairwise(groups))
    assert changes + 1 == len(set(groups))


def test_logs_by_pattern_are_beside_the_file_and_named_by_their_stems(tmp_path):
    for name in ("b.mcap", "a.mcap", "c.txt"):
        (tmp_path / name).write_bytes(EMPTY)
    path = tmp_path / "suite.toml"
    path.write_text('version = 1\nlogs = ["*.mcap"]\npipelines = ["lidar3d"]\n')
    suite = read_suite(path)
    assert [(log.name, log.request.path.name) for log in suite.logs] == [("a", "a.mcap"), ("b", "b.mcap")]
    assert suite.folder == Path("runs/suite")


def test_a_changed_parameter_keeps_the_name_and_the_folder(tmp_path):
    before, after = (suite_of(GOOD.replace("=60", f"={m}"), tmp_path).cells() for m in (60, 30))
    assert [(c.pipeline, c.request.out) for c in before] == [(c.pipeline, c.request.out) for c in after]


HEAD = "version = 1\n"
LOG = '[[logs]]\nsimulate = "urban"\n'
LIST = 'pipelines = ["lidar3d"]\n'
HERE = '[[logs]]\npath = "."\n'


@pytest.mark.parametrize(
    ("content", "line", "text"),
    [
        (HEAD + LIST + 'condition = ["fog"]\n' + LOG, 3, "'condition': isn't known; did you mean 'conditions'?"),
        (HEAD + LIST + LOG + "secnods = 3.0\n", 5, "'logs.0.secnods': isn't known; did you mean 'seconds'?"),
        (HEAD + LIST + LOG + '[scoring]\nrange = 3.0\n', 6, "'scoring.range': isn't known"),
        (HEAD + LIST + LOG + LOG + 'seed = "three"\n', 7, "'logs.1.seed'"),
        (HEAD + 'rates = "max"\n' + LIST + LOG, 2, "'rates': Input should be a valid list"),
        (HEAD + LIST + "seeds = [-1]\n" + LOG, 3, "'seeds.0'"),
        (HEAD + LOG + 'path = "x.mcap"\n' + "[pipelines.lidar3d]\n", 2, "expected either path or simulate"),
        (HEAD + LIST + 'logs = ["no.mcap"]\n', 3, "'logs.0.path': no such log: no.mcap"),
        (HEAD + LIST + '[[logs]]\npath = "no/*.mcap"\n', 4, "no such log: no/*.mcap"),
        (HEAD + LIST + LOG.replace("urban", "urbna"), 3, "no simulated world 'urbna'; did you mean 'urban'?"),
        (HEAD + LIST + LOG + LOG, 5, "'urban-clear-0' is listed twice"),
        (HEAD + LIST + LOG + 'name = "a"\n' + LOG + 'seed = 1\nname = "a"\n', 6, "two logs are called 'a'"),
        (HEAD + LIST + LOG + 'name = "../a"\n', 5, "'../a' can't be a name"),
        (HEAD + LIST + LOG + 'name = "/etc"\n', 5, "'/etc' can't be a name"),
        (HEAD + LOG + '[pipelines."a/b"]\nbase = "lidar3d"\n', 4, "'a/b' can't be a name"),
        (HEAD + LOG + '[pipelines.".."]\nbase = "lidar3d"\n', 4, "'..' can't be a name"),
        (HEAD + 'out = "../elsewhere"\n' + LIST + LOG, 2, "'out': isn't known"),
        (HEAD + LOG + '[pipelines.a]\nbase = "lidar4d"\n', 4, "unknown pipeline 'lidar4d'"),
        (HEAD + LOG + '[pipelines.a]\nbase = "lidar3d"\nset = ["lidar.rnage=3"]\n', 6, "lidar.rnage"),
        (HEAD + 'pipelines = ["lidar3d", "lidar3d"]\n' + LOG, 2, "'lidar3d' is listed twice"),
        (HEAD + LIST + 'conditions = ["fgo"]\n' + LOG, 3, "did you mean 'fog'"),
        (HEAD + LIST + 'conditions = ["fog", "fog:3"]\n' + LOG, 3, "'fog:3' is listed twice"),
        (HEAD + LIST + 'conditions = ["fog:9"]\n' + LOG, 3, "expected a severity of 0 to 5"),
        (HEAD + LIST + 'rates = ["fast"]\n' + LOG, 3, "expected 'max' or a positive number"),
        (HEAD + LIST + "seeds = [1, 2, 1]\n" + LOG, 3, "'seeds.2': 1 is listed twice"),
        (HEAD + LIST + LOG + '[scoring]\nprofiles = ["kiti"]\n', 6, "kiti"),
        (HEAD + LIST + LOG + '[replay]\nstamps = "now"\n', 6, "'replay.stamps'"),
        (HEAD + LIST + LOG + '[replay]\nfrom = "x"\n', 6, "'replay.from': x: expected seconds from the start on"),
        (HEAD + LIST + LOG + '[replay]\nframes = "b"\n', 6, "'replay.frames': b: expected A:B"),
        (HEAD + LIST + LOG + '[replay]\nfault_budget = ["x"]\n', 6, "'replay.fault_budget': x: expected a number"),
        (HEAD + LIST + LOG + '[replay]\ninterpolate_truth_ms = 1e8\n', 6, "'replay.interpolate_truth_ms': 1e+08"),
        (HEAD + LIST + LOG + '[[replay]]\nframes = "1"\n', 5, "'replay'"),
        (HEAD + LIST + 'rates = ["1", "1.0"]\n' + LOG, 3, "'rates.1': 1.0 is listed twice"),
        (HEAD + LIST + 'conditions = ["clear", "fog:0"]\n' + LOG, 3, "'fog:0' changes nothing; write 'clear'"),
        (HEAD + LIST + LOG.replace('"urban"', "[]"), 4, "'logs.0.simulate': List should have at least 1 item"),
        (HEAD + LIST + LOG + "seed = []\n", 5, "'logs.0.seed': List should have at least 1 item"),
        (HEAD + LIST + LOG + 'truth_format = "kitti"\n', 5, "'logs.0.truth_format': is for a recorded log"),
        (HEAD + LIST + HERE + 'truth_format = "kitti"\n', 5, "'logs.0.truth_format': goes with truth"),
        (HEAD + LIST + HERE + 'truth = "."\ntruth_format = "kiti"\n', 6, "'kiti' isn't a format; did you mean 'kitti'"),
        (HEAD + LIST + HERE + 'config = "no.toml"\n', 5, "'logs.0.config': no such file: no.toml"),
        (HEAD + LIST + HERE + 'rig = ["no.yaml"]\n', 5, "'logs.0.rig.0': no such file: no.yaml"),
        (HEAD + LIST + 'logs = ["a\\u0000.mcap"]\n', 3, "'logs.0': has characters that can't be printed"),
        (HEAD + LIST + f'logs = ["{"a" * 900}"]\n', 3, "'logs.0.path': can't be read (File name too long)"),
        (HEAD + 'pipelines = ["a\\u0000.toml"]\n' + LOG, 2, "'pipelines.0': has characters that can't be printed"),
        (HEAD + 'title = "a\\nb"\n' + LIST + LOG, 2, "'title': has characters that can't be printed"),
        ("version = 2\n" + LIST + LOG, 1, "'version'"),
        ("version = true\n" + LIST + LOG, 1, "'version': expected a whole number"),
        ("version = 1.0\n" + LIST + LOG, 1, "'version': expected a whole number"),
        (LIST + LOG, 1, "'version' is missing"),
        (HEAD + LOG, 1, "'pipelines' is missing"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line_with_file_line_and_key(tmp_path, content, line, text):
    with pytest.raises(ConfigError) as raised:
        suite_of(content, tmp_path)
    said = str(raised.value)
    assert said.startswith(f"suite.toml:{line}: "), said
    assert text in said
    assert "\n" not in said


@pytest.mark.parametrize(
    ("path", "line", "text"),
    [
        ("text.mcap", 4, "'logs.0.path': text.mcap: not a log (looks like text)"),
        ("t*.mcap", 4, "not a log"),
        ("nothing", 4, "'logs.0.path': nothing: no log (a folder without log.json"),
        ("pipe.mcap", 4, "'logs.0.path': pipe.mcap: not a regular file"),
        ("/dev/null", 4, "'logs.0.path': /dev/null: not a regular file"),
        ('a.mcap"\ntruth = "pipe.mcap', 5, "'logs.0.truth': pipe.mcap: neither a regular file nor a folder"),
        ('a.mcap"\ntruth = "text.mcap', 5, "'logs.0.truth': text.mcap: "),
        ('a.mcap"\nrig = ["pipe.mcap"]\nname = "a', 5, "'logs.0.rig.0': not a file: pipe.mcap"),
        ('a.mcap"\nconfig = "pipe.mcap', 5, "'logs.0.config': not a file: pipe.mcap"),
    ],
)
def test_what_is_no_log_is_refused_before_anything_runs(tmp_path, monkeypatch, path, line, text):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.mcap").write_bytes(EMPTY)
    (tmp_path / "text.mcap").write_text("not a log at all")
    (tmp_path / "nothing").mkdir()
    os.mkfifo(tmp_path / "pipe.mcap")
    with pytest.raises(ConfigError) as raised:
        suite_of(f'{HEAD}{LIST}[[logs]]\npath = "{path}"\n', Path())
    assert str(raised.value).startswith(f"suite.toml:{line}: ")
    assert text in str(raised.value)


def test_regions_that_no_log_has_are_refused_before_anything_runs(tmp_path):
    road = Region("road", np.array([[0.0, 0], [9, 0], [9, 9]]))
    write_log(tmp_path / "a.mcap", [], metadata={REGIONS: regions_text([road])})
    write_log(tmp_path / "b.mcap", [])
    content = f"{HEAD}{LIST}logs = [{{}}]\n[scoring]\nregions = {{}}\n"
    suite_of(content.format('"b.mcap", "a.mcap"', '["road"]'), tmp_path)
    for logs, kinds, why in (
        ('"b.mcap"', '["road"]', "0': no log has a region 'road'; there are none"),
        ('"a.mcap"', '["road", "raod"]', "1': no log has a region 'raod'; did you mean 'road'?"),
    ):
        with pytest.raises(ConfigError) as raised:
            suite_of(content.format(logs, kinds), tmp_path)
        assert str(raised.value) == f"suite.toml:5: 'scoring.regions.{why}"


def test_cameras_that_no_log_has_are_refused_before_anything_runs(tmp_path):
    content = f'{HEAD}{LIST}logs = [{{{{simulate = "urban", sensors = ["camera"]}}}}]\n[scoring]\ncameras = {{}}\n'
    suite_of(content.format('["camera"]'), tmp_path)
    with pytest.raises(ConfigError, match=r"suite.toml:5: 'scoring.cameras.1': no log has a camera 'camra'; did you"):
        suite_of(content.format('["camera", "camra"]'), tmp_path)


def test_what_is_no_toml_says_where(tmp_path):
    with pytest.raises(ConfigError, match=r"suite.toml: isn't TOML .*line 3"):
        suite_of("version = 1\nlogs = [\n[x\n", tmp_path)


def test_lines_of_keys():
    content = 'a = 1\n[b.c]\nd = 2\n[[e]]\nf = 3\n[[e]]\n"f" = 4\n'
    assert find_line(content, ("a",)) == 1
    assert find_line(content, ("b", "c", "d")) == 3
    assert find_line(content, ("e", 1, "f")) == 7
    assert find_line(content, ("e", 0, "nothing")) == 4
    assert find_line(content, ("e",)) == 4
    assert find_line(content, ("z",)) == 1
