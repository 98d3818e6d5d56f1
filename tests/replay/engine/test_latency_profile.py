"""Profiles of latency: what is drawn from them by hand, by independent arithmetic, and in replays; bad files."""

import json
import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest
from tests.replay.engine.test_latency import times
from tests.replay.engine.test_run import content, play
from tests.replay.engine.test_service_queue import simulate
from tests.replay.fakes import MS, drive

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.engine.latency_profile import (
    MOST_NS,
    REST,
    FrameContent,
    LatencyProfile,
    StageModel,
    digest_parameters,
    load_profile,
)
from fbench.replay.engine.service_queue import OverloadPolicy, make_latency
from fbench.replay.runs.folder import Run

DETECT, NOTHING = "detect.lidar", FrameContent(0, 0, 0)


def stage(name, base_ns=0, point=0, box=0, pixel=0):
    return StageModel(stage=name, base_ns=base_ns, ps_per_point=point, ps_per_box=box, ps_per_pixel=pixel)


def make(stages=(), residuals=((0,),), **fields):
    facts = {"pipeline": "echo", "log": "fake", "repeats": 1, "host": {}} | fields
    return LatencyProfile(stages=[*stages, stage(REST)], residuals_ns=[[*row] for row in residuals], **facts)


BOTH = (DETECT, "track")
_RESIDUALS = [[20 * MS, 1, MS], [90 * MS, 0, 0], [-5 * MS, 0, 0], [240 * MS, 2, 7]]
ECHO = make([stage(DETECT, 80 * MS, box=10_000), stage("track")], _RESIDUALS)


def save(folder, profile=ECHO, name="orin.json"):
    path = folder / name
    path.write_text(profile.model_dump_json())
    return path


def draw(profile, frame, held=NOTHING, ran=(DETECT,), seed=0, log_id="fake-1"):
    return profile.draw_ns(seed, log_id, frame, held, ran)


def test_a_time_is_base_and_rates_and_a_residual():
    """1 us + 2 ns x 300 points + 0.5 ns x 5 boxes + 0.001 ns x 1001 pixels, cut to whole ns, then 7 - 2."""
    profile = make([stage(DETECT, 1000, point=2000, box=500, pixel=1)], [[7, -2]])
    assert draw(profile, 0, FrameContent(300, 5, 1001)) == 1000 + 600 + 3 + 5
    assert draw(profile, 0) == 1005


def test_stages_are_drawn_together_from_frames_in_which_the_same_ones_ran():
    rows = [[1, 10, 100], [2, 20, 200], [None, 30, 300], [None, 40, 400]]
    profile = make([stage(DETECT), stage("track")], rows)
    assert {draw(profile, i, ran=[DETECT, "track"]) for i in range(50)} == {111, 222}
    assert {draw(profile, i, ran=["track"]) for i in range(50)} == {330, 440}
    # Detection alone was never seen: frames in which it ran at all stand for it.
    assert {draw(profile, i, ran=[DETECT]) for i in range(50)} == {101, 202}
    assert {draw(profile, i, ran=None) for i in range(99)} == {111, 222, 330, 440}


def test_draws_are_spread_evenly_and_depend_on_seed_log_and_frame_alone():
    profile = make(residuals=[[i] for i in range(8)])
    drawn = Counter(draw(profile, i, ran=()) for i in range(4000))
    assert sorted(drawn) == [*range(8)]
    assert max(abs(num - 500) for num in drawn.values()) < 100  # 4.8 standard deviations
    own = [draw(profile, i, ran=()) for i in range(64)]
    assert own == [draw(profile, i, ran=()) for i in range(63, -1, -1)][::-1]
    assert own != [draw(profile, i, ran=(), seed=1) for i in range(64)]
    assert own != [draw(profile, i, ran=(), log_id="fake-2") for i in range(64)]


def test_a_time_is_never_negative_or_beyond_a_day():
    assert draw(make(residuals=[[-5]]), 0, ran=()) == 0
    assert draw(make([stage(DETECT, MOST_NS)], [[MOST_NS, 0]]), 0) == MOST_NS


def test_a_stage_that_was_not_recorded_is_refused():
    with pytest.raises(ConfigError, match=r"runs stage 'detect\.radar', which the profile doesn't know"):
        draw(ECHO, 0, ran=["detect.radar"])


@pytest.mark.parametrize("overload", ["newest", "skip", "fifo:2"])
def test_replays_agree_with_the_simulation_of_events(tmp_path, overload):
    path = save(tmp_path)
    model = make_latency(f"profile:{path}", overload, 2.0, seed=5)
    run = play(drive(30), tmp_path / "run", latency=model)
    lockstep = play(drive(30), tmp_path / "lockstep")
    service = ECHO.draw_run_ns(5, lockstep, lockstep.manifest.log.log_id)
    assert service == [draw(ECHO, i, FrameContent(3, 1, 0), BOTH, seed=5) for i in range(30)]
    depth = OverloadPolicy("fifo", 2) if overload == "fifo:2" else OverloadPolicy(overload)
    expected = simulate(depth, [f.ready_ns for f in run.frames], [2 * ns for ns in service])
    assert [None if f.is_dropped else (f.start_ns, f.done_ns) for f in run.frames] == expected
    assert 0 < run.manifest.latency.num_dropped < 30
    entry = run.manifest.latency.profile
    assert (entry.name, entry.seed, run.manifest.latency.service_ns) == ("orin.json", 5, None)
    assert str(run.manifest.latency) == f"profile:orin.json with seed 5, overload {overload}, at 2x"


def test_equal_profile_and_seed_give_equal_bytes(tmp_path):
    path = save(tmp_path)
    runs = [
        play(drive(), tmp_path / str(i), latency=make_latency(f"profile:{path}", None, None, seed))
        for i, seed in enumerate((3, 3, 4))
    ]
    assert content(runs[0].folder) == content(runs[1].folder)
    assert times(runs[0]) != times(runs[2])


def test_redacted_runs_do_not_name_the_file(tmp_path):
    model = make_latency(f"profile:{save(tmp_path, name='secret.json')}", None, None)
    run = play(drive(), tmp_path / "run", latency=model, redact=True)
    assert "secret" not in (run.folder / "manifest.json").read_text()


def test_other_processes_and_thread_counts_draw_the_same(tmp_path):
    path = save(tmp_path)
    code = (
        "import sys; from pathlib import Path\n"
        "from fbench.replay.engine.latency_profile import *\n"
        "p, _ = load_profile(Path(sys.argv[1]))\n"
        "print(*(p.draw_ns(1, 'log', i, FrameContent(i, 2, 3), ['detect.lidar', 'track']) for i in range(200)))"
    )
    found = set()
    for threads in ("1", "3"):
        names = ("FBENCH_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")
        environment = {**dict.fromkeys(names, threads), "PYTHONHASHSEED": threads}
        command = [sys.executable, "-c", code, str(path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        found.add(done.stdout)
    assert len(found) == 1
    own = [ECHO.draw_ns(1, "log", i, FrameContent(i, 2, 3), BOTH) for i in range(200)]
    assert [*map(int, found.pop().split())] == own


def test_frames_that_failed_take_the_time_of_a_whole_one(tmp_path):
    run = play(drive(), tmp_path / "run")
    failed = replace(run.frames[3], failed="why")
    run.__dict__["frames"] = (*run.frames[:3], failed, *run.frames[4:])
    assert ECHO.draw_run_ns(0, run, run.manifest.log.log_id)[3] == draw(ECHO, 3, FrameContent(3, 1, 0), ran=None)


def test_other_parameters_are_refused():
    own = {"eps_m": 0.6, "weights": {"file": "/a/net.onnx", "sha256": "12"}}
    profile = ECHO.model_copy(update={"parameters": digest_parameters(own)})
    profile.require_parameters({**own, "weights": {"file": "/b/net.onnx", "sha256": "12"}, "new": 1})
    ECHO.require_parameters(own)  # an older one doesn't know
    with pytest.raises(ConfigError, match=r"another value of parameter eps_m, and 1 more"):
        profile.require_parameters({"eps_m": 0.7, "weights": {"file": "/a/net.onnx", "sha256": "13"}})


def test_a_profile_is_kept_as_it_is(tmp_path):
    found, digest = load_profile(save(tmp_path))
    assert found == ECHO
    assert digest != load_profile(save(tmp_path, make()))[1]


def without(key):
    return lambda content: content.pop(key)


def put(value, *keys):
    def change(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = value

    return change


@pytest.mark.parametrize(
    ("spoil", "line"),
    [
        (put(2, "version"), "is a latency profile of version 2, this fbench reads 1; record it again"),
        (without("version"), "is a latency profile of version None"),
        (without("kind"), "not a latency profile; fbench profile writes one"),
        (without("stages"), "stages: Field required"),
        (without("pipeline"), "pipeline: Field required"),
        (put([], "stages"), "stages: List should have at least 1 item"),
        (put([], "residuals_ns"), "residuals_ns: List should have at least 1 item"),
        (put(-1, "stages", 0, "base_ns"), "stages.0.base_ns: Input should be greater than or equal to 0"),
        (put(float("nan"), "stages", 0, "base_ns"), "stages.0.base_ns: Input should be a valid integer"),
        (put(float("nan"), "residuals_ns", 0, 0), "residuals_ns.0.0: Input should be a valid integer"),
        (put(1.5, "stages", 0, "ps_per_box"), "stages.0.ps_per_box: Input should be a valid integer"),
        (put(10**30, "residuals_ns", 0, 0), "residuals_ns.0.0: Input should be less than or equal to"),
        (put([1], "residuals_ns", 1), "residuals_ns.1: expected 3 numbers"),
        (
            put([1, 0, None], "residuals_ns", 1),
            "residuals_ns.1: expected 3 numbers, null only where a stage didn't run",
        ),
        (put(DETECT, "stages", 1, "stage"), "stages: expected different ones, and '(rest)' among them"),
        (put(1, "more"), "more: Extra inputs are not permitted"),
    ],
)
def test_files_that_are_no_profile(tmp_path, spoil, line):
    found = json.loads(ECHO.model_dump_json())
    spoil(found)
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(found))
    with pytest.raises(ConfigError) as error:
        make_latency(f"profile:{path}", None, None)
    assert line in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("data", [b"", b"{", b"[]", b"\xff\xfe", b"[" * 100_000, b"null"])
def test_files_that_are_no_json_object(tmp_path, data):
    (tmp_path / "bad.json").write_bytes(data)
    with pytest.raises(ConfigError, match=r"bad\.json: not a latency profile"):
        load_profile(tmp_path / "bad.json")


def test_files_that_are_not_there(tmp_path):
    for path in (tmp_path / "none.json", tmp_path):
        with pytest.raises(ConfigError, match="no such file; fbench profile writes one"):
            load_profile(path)


def test_another_pipeline_is_refused():
    with pytest.raises(ConfigError, match="was recorded of pipeline 'echo', not of 'late3d'"):
        ECHO.require_pipeline("late3d")


def test_runs_say_what_their_frames_held(tmp_path):
    run = Run(play(drive(3), tmp_path / "run").folder)
    assert [(f.num_points, f.num_pixels) for f in run.frames] == [(3, 0)] * 3
