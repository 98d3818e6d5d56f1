"""Which runs may be compared, and what is said of their differences."""

from typing import Any

import pytest
from tests.metrics.conftest import make_manifest

from fbench.metrics.comparison.pairing import require_common_instants, require_comparable
from fbench.replay.contracts.errors import MetricError
from fbench.replay.runs.folder import FrameRecord, Run, RunWriter
from fbench.replay.runs.manifest import ConditionEntry, InputEntry, LogEntry, Manifest, MountEntry, TruthEntry


class TestRequireComparable:
    def test_equal_runs_have_no_notes(self) -> None:
        assert require_comparable(make_manifest(), make_manifest()) == ()

    def test_other_logs_are_refused(self) -> None:
        other = make_manifest(log=LogEntry(name="other", log_id="id", digest="e" * 32, metadata={}))
        with pytest.raises(MetricError, match=r"base is 'log' \(dddddddddddd\), head is 'other' \(eeeeeeeeeeee\)"):
            require_comparable(make_manifest(), other)

    def test_what_else_differs_is_noted(self) -> None:
        notes = require_comparable(make_manifest(), make_manifest(pipeline="late3d", complete=False))
        assert notes == ("pipeline: lidar3d -> late3d", "head is incomplete")

    def test_other_truth_calibration_and_configuration_are_noted(self) -> None:
        config, other = (InputEntry(role="config", name="fbench.toml", digest=d * 16) for d in ("a1", "b2"))
        rig = InputEntry(role="rig", name="fix.urdf", digest="c3" * 16)
        truth = TruthEntry(name="labels.csv", format="table", digest="d4" * 16)
        head = make_manifest(inputs=[other, rig], truth=truth)
        assert require_comparable(make_manifest(inputs=[config]), head) == (
            "config: fbench.toml (a1a1a1a1) -> fbench.toml (b2b2b2b2)",
            "rig: none -> fix.urdf (c3c3c3c3)",
            "truth: none -> labels.csv (d4d4d4d4)",
        )
        assert require_comparable(head, head) == ()
        named = head.model_copy(update={"truth": truth.model_copy(update={"frame": "lidar", "camera": "front"})})
        assert require_comparable(head, named) == (
            "truth: labels.csv (d4d4d4d4) -> labels.csv (d4d4d4d4, in lidar, in front)",
        )

    def test_one_log_under_conditions_is_noted(self) -> None:
        fog = ConditionEntry(name="fog", version=1, strength="3", level={"visibility_m": 150.0}, sensors="lidar")
        late = ConditionEntry(name="delay", version=1, strength="2", level={"delay_ms": 50.0}, from_s=1.0)
        base = make_manifest(log=LogEntry(name="log", log_id="id", digest="d" * 32, metadata={}))
        head = make_manifest(
            log=LogEntry(name="log", log_id="id", digest="e" * 32, metadata={}), conditions=[fog, late], seed=4
        )
        assert require_comparable(base, head) == ("conditions: none -> fog.lidar:3+delay:2 (1s-), seed 4",)
        other = head.model_copy(update={"log": LogEntry(name="x", log_id="other", digest="f" * 32, metadata={})})
        with pytest.raises(MetricError, match="different logs"):
            require_comparable(base, other)


def of_scene(scene: str, digest: str, condition: str, **changes: Any) -> Manifest:
    metadata = {"scene_id": scene, "condition": condition, "seed": "3"}
    return make_manifest(log=LogEntry(name=condition, log_id=digest, digest=digest * 32, metadata=metadata), **changes)


def mount(x: float) -> MountEntry:
    return MountEntry(kind="lidar", translation_m=[x, 0, 0], rotation_xyzw=[0, 0, 0, 1])


class TestOneScene:
    def test_its_logs_are_comparable_and_told_apart(self) -> None:
        notes = require_comparable(of_scene("a", "d", "clear"), of_scene("a", "e", "fog"))
        assert notes == ("log: 'clear' (dddddddddddd) -> 'fog' (eeeeeeeeeeee)", "condition: clear -> fog")

    def test_other_sensors_are_noted(self) -> None:
        base = of_scene("a", "d", "clear", mounts={"side": mount(0), "top": mount(0)})
        head = of_scene("a", "e", "clear", mounts={"top": mount(1)}, num_frames=2)
        assert require_comparable(base, head)[1:] == (
            "sensors: side, top -> top", "calibration of top: one -> another", "frames: 1 -> 2",
        )  # fmt: skip

    @pytest.mark.parametrize(("base", "head"), [("a", "b"), ("", ""), ("a", "")])
    def test_other_scenes_and_logs_without_one_are_refused(self, base: str, head: str) -> None:
        with pytest.raises(MetricError, match="different logs can't be compared"):
            require_comparable(of_scene(base, "d", "clear"), of_scene(head, "e", "fog"))


class TestCommonInstants:
    @pytest.fixture
    def run(self, tmp_path):
        def make(digest: str, *stamps_ns: int) -> Run:
            with RunWriter(tmp_path / digest) as writer:
                for i, stamp_ns in enumerate(stamps_ns):
                    writer.add_frame(FrameRecord(i, stamp_ns, 0, None, {}, "", ""), {"total": 1})
                return Run(writer.finish(of_scene("a", digest, "clear")))

        return make

    def test_frames_of_one_run_alone_are_noted(self, run) -> None:
        base, head = run("d", 0, 100, 200), run("e", 100, 200, 300, 400)
        assert require_common_instants(base, head) == (
            "1 frame is at instants that base alone has", "2 frames are at instants that head alone has",
        )  # fmt: skip
        assert require_common_instants(base, base) == ()

    def test_none_in_common_is_refused(self, run) -> None:
        with pytest.raises(MetricError, match="without a frame at the same instant"):
            require_common_instants(run("d", 0, 100), run("e", 50, 150))
