"""`--device`: networks run where it says, or not at all."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from tests.cuda import HAS_CUDA, needs_cuda

from fbench.api import CityRequest, LogRequest, ReplayRequest, SimulateRequest, replay, replays, simulate
from fbench.api.suites.contents import Contents, key_of
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.pipelines.sensors.camera import providers
from fbench.pipelines.sensors.camera.providers import CPU, CUDA, open_session
from fbench.replay.contracts.devices import current_execution, note_provider, use_device
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.data.boxes import Boxes2D
from fbench.replay.runs import host, manifest

CARD = {"card": "Card 9000", "driver": "13.0"}
PLUGIN = """
from fbench.replay.contracts.devices import current_execution, note_provider
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Output

class Mine:
    def __init__(self):
        self.made_on = current_execution().device
    def start(self, rig, log_info):
        note_provider(f"mine on {current_execution().device}")
    def reset(self, reason): pass
    def step(self, frame): return self.conclude(frame, self.observe(frame))
    def pass_by(self, frame): pass
    def observe(self, frame): return self.made_on, current_execution().device
    def conclude(self, frame, observed):
        assert observed == ("cuda", "cuda")
        return Output(Boxes3D.empty(), None, {})
"""
SUITE = 'version = 1\nlogs = ["car.mcap"]\npipelines = ["lidar3d"]\n'


@pytest.mark.skipif(HAS_CUDA, reason="there is a GPU that would be used")
@pytest.mark.parametrize(
    "command",
    ["replay {log} -p learned3d -o new", "replay {log} -p lidar3d -o new", "verify {log} -p learned3d --keep new",
     "sweep {log} -p learned3d --latency fixed:80ms -o new", "profile {log} -p learned3d -o new",
     "robust {log} -p learned3d,lidar3d --condition fog:3 -o new", "bench suite.toml -o new", "demo -o new",
     "verify {log} -p learned3d --relations --keep new"],
)  # fmt: skip
def test_cuda_that_isnt_there_ends_all_before_it_begins(fbench, log, tmp_path, command):
    (tmp_path / "suite.toml").write_text(SUITE)
    result = fbench(*command.format(log=log).split(), "--device", "cuda")
    assert (result.code, result.out, result.err.count("\n")) == (2, "", 1)
    assert result.err.startswith("fbench: --device cuda: ")
    assert "pip install 'onnxruntime-gpu[cuda,cudnn]==" in result.err
    assert not [path for path in tmp_path.glob("new*") if path.is_file() or any(path.iterdir())]


def test_no_other_device_is_known(log):
    with pytest.raises(ConfigError, match=r"^--device gpu: expected cpu or cuda$"):
        replay(ReplayRequest(LogRequest(log), "lidar3d", device="gpu"))


@pytest.mark.parametrize(
    ("more", "provider"), [(("-p", "learned3d", "--set", "network.threads=1"), CPU), (("-p", "lidar3d"), None)]
)
def test_the_manifest_says_where_networks_ran(fbench, log, tmp_path, more, provider):
    assert fbench("replay", log, *more, "--frames", ":1", "-o", "run").code == 0
    found = json.loads((tmp_path / "run" / "manifest.json").read_text())["execution"]
    level = "equal bytes on one type of machine, with equal versions"
    assert found == {"device": "cpu", "provider": provider, "determinism": level}
    assert "device" not in json.loads((tmp_path / "run" / "host.json").read_text())


@pytest.mark.parametrize("more", [{}, {"isolate": True}, {"overlap": 2}])
def test_a_plug_in_learns_the_device_in_every_process(log, tmp_path, monkeypatch, more):
    monkeypatch.setattr(replays, "require_device", lambda device: None)
    (tmp_path / "mine.py").write_text(PLUGIN)
    request = ReplayRequest(LogRequest(log), f"{tmp_path}/mine.py:Mine", out=tmp_path / "run", device="cuda", **more)
    run = replay(request).run
    assert [frame.failed for frame in run.frames] == [None] * 6
    assert (run.manifest.execution.device, run.manifest.execution.provider) == ("cuda", "mine on cuda")


@pytest.mark.skipif(HAS_CUDA, reason="there is a GPU that would be used")
def test_a_worker_of_a_suite_refuses_what_its_machine_lacks(log, tmp_path):
    """It may be on another machine than who asks."""
    cell = ReplayRequest(LogRequest(log), "lidar3d", out=tmp_path / "run", device="cuda")
    (result,) = run_suite([cell], RunOptions(1))
    assert (result.state, str(result.reason)[:15]) == ("failed", "--device cuda: ")


class _Runtime:
    """Stands for onnxruntime with a CUDA provider, which isn't here."""

    __version__ = "1.31.1"

    def __init__(self, *used):
        self.used, self.asked = list(used), []

    def get_available_providers(self):
        return [CUDA, CPU]

    def set_default_logger_severity(self, level):
        pass

    def preload_dlls(self):
        sys.stdout.write("Failed to load libcublas.so.13: no such file\nanother line\n")

    def InferenceSession(self, data, options, providers, enable_fallback):
        self.asked = providers
        assert enable_fallback == 0
        return SimpleNamespace(get_providers=lambda: self.used)


def test_cuda_runs_without_tf32_and_without_timing_algorithms(monkeypatch):
    runtime = _Runtime(CUDA, CPU)
    monkeypatch.setattr(providers, "onnxruntime", runtime)
    for module in (providers, manifest):
        monkeypatch.setattr(module, "describe_cuda", lambda: CARD)
    with use_device("cuda"):
        open_session(b"", None)
        open_session(b"", None)
        entry = manifest.execution_entry()
    (name, options), last = runtime.asked
    assert (name, last, options["use_tf32"], options["cudnn_conv_algo_search"]) == (CUDA, CPU, "0", "HEURISTIC")
    assert (entry.device, entry.provider, entry.cuda, str(entry)) == ("cuda", CUDA, CARD, "cuda (Card 9000)")
    assert "one type of card" in entry.determinism
    assert current_execution().providers == [], "that of the block alone"


def test_onnxruntime_may_not_go_on_with_the_cpu(monkeypatch):
    monkeypatch.setattr(providers, "onnxruntime", _Runtime(CPU))
    monkeypatch.setattr(providers, "describe_cuda", lambda: CARD)
    what = r"its CUDA provider \(Failed to load libcublas.so.13: no such file\); pip install"
    with use_device("cuda"), pytest.raises(ConfigError, match=what):
        open_session(b"", None)


def test_a_provider_needs_a_gpu(monkeypatch):
    monkeypatch.setattr(providers, "onnxruntime", _Runtime(CUDA, CPU))
    monkeypatch.setattr(providers, "describe_cuda", dict)
    with use_device("cuda"), pytest.raises(ConfigError, match="driver isn't installed here, or finds no GPU"):
        open_session(b"", None)


def test_the_choice_ends_with_its_block():
    with use_device("cuda") as outer:
        note_provider(CUDA)
        with use_device("cpu"):
            note_provider(CPU)
            assert current_execution().device == "cpu"
        assert (current_execution(), outer.providers) == (outer, [CUDA])
    assert current_execution().device == "cpu"


def test_runs_on_other_devices_are_compared_and_it_says_so(fbench, log, tmp_path):
    for name in ("base", "head"):
        assert fbench("replay", log, "-p", "lidar3d", "--frames", ":3", "-o", name).code == 0
    for name, change in (
        ("manifest", {"execution": {"device": "cuda", "provider": CUDA, "determinism": "", "cuda": CARD}}),
        ("host", {"device": "cuda", "card": CARD["card"]}),
    ):
        path = tmp_path / "head" / f"{name}.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    result = fbench("compare", "base", "head")
    assert result.code == 0
    assert "note: networks: cpu -> cuda (Card 9000)\n" in result.out
    text = " ".join(result.out.split())
    assert "note: networks on different devices agree within tolerances, not bit for bit" in text
    assert "latencies can't be compared: networks on the CPU and Card 9000" in text
    assert fbench("report", "base", "head").code == 0
    assert "Card 9000" in (tmp_path / "base" / "report.html").read_text()


def test_a_cell_that_ran_on_the_cpu_isnt_taken_for_one_on_a_gpu(log, tmp_path):
    cell = ReplayRequest(LogRequest(log), "learned3d", out=tmp_path / "run")
    contents = Contents()
    on_cpu, on_cuda = (contents.of(replace(cell, device=device)) for device in ("cpu", "cuda"))
    assert key_of(on_cpu) != key_of(on_cuda)
    assert on_cuda == {**on_cpu, "cuda": dict(host.describe_cuda())}


PX, M, SCORE = 0.2, 0.01, 0.002
"""How far apart boxes of the CPU and of a GPU may be: corners of boxes in images, centers and sizes, scores."""


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """Half a second of the city."""
    path = tmp_path_factory.mktemp("city") / "city.mcap"
    simulate(SimulateRequest(CityRequest("urban", seconds=0.6, seed=9001), path))
    return path


def boxes_of(run):
    """Frame, label, score, and the numbers of each detection."""
    boxes = run.detections.boxes
    frames = np.asarray(run.detections.frames)
    in_2d = isinstance(boxes, Boxes2D)
    values = boxes.xyxy_px if in_2d else np.column_stack([boxes.center_m, boxes.size_lwh_m])
    cameras = boxes.camera if in_2d else np.full(len(boxes), "")
    keys = [f"{frame} {camera} {label}" for frame, camera, label in zip(frames, cameras, boxes.label, strict=True)]
    return np.array(keys), boxes.score, values


@needs_cuda
@pytest.mark.parametrize(
    ("pipeline", "settings", "least", "tolerance"),
    [("camera2d", [], 0.6, PX), ("learned3d", [], 0.4, M),
     ("late3d", ["lidar.detector=learned", "detect_every=1"], None, None)],
)  # fmt: skip
def test_cuda_finds_what_the_cpu_finds(city, tmp_path, pipeline, settings, least, tolerance):
    runs = {}
    for name, device, more in (
        ("cpu", "cpu", {}), ("cuda", "cuda", {}), ("again", "cuda", {}), ("overlap", "cuda", {"overlap": 2}),
        ("isolated", "cuda", {"isolate": True}),
    ):  # fmt: skip
        request = ReplayRequest(LogRequest(city), pipeline, settings, out=tmp_path / name, device=device, **more)
        runs[name] = replay(request).run
    entry = runs["cuda"].manifest.execution
    assert (entry.device, entry.provider) == ("cuda", CUDA)
    assert entry.cuda["card"]
    digests = {name: run.manifest.digest for name, run in runs.items() if name != "cpu"}
    assert len(set(digests.values())) == 1, digests
    assert {run.manifest.execution.device for name, run in runs.items() if name != "cpu"} == {"cuda"}
    (keys, scores, values), (other_keys, other_scores, other_values) = map(boxes_of, (runs["cpu"], runs["cuda"]))
    assert len(keys) > 20
    if tolerance is None:  # fusion may turn on a score that is just enough
        assert abs(len(keys) - len(other_keys)) <= len(keys) // 50
        return
    for mine, others in (
        ((keys, scores, values), (other_keys, other_scores, other_values)),
        ((other_keys, other_scores, other_values), (keys, scores, values)),
    ):
        for key, score, value in zip(*mine, strict=True):
            same = others[0] == key
            apart = np.abs(others[2][same] - value).max(axis=1, initial=0) if same.any() else np.array([np.inf])
            best = int(np.argmin(apart))
            if apart[best] > tolerance:
                assert score < least + SCORE, f"{key}: {score} is alone, the nearest is {apart[best]} away"
            else:
                assert abs(others[1][same][best] - score) <= SCORE


@needs_cuda
def test_cuda_holds_under_verify(fbench, city):
    result = fbench("verify", city, "-p", "learned3d", "--quick", "--device", "cuda")
    assert result.code == 0, result.out
    assert "device: cuda" in result.out
