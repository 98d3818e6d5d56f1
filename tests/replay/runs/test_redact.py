"""What is left of names and texts under `--redact`."""

import pytest

from fbench.replay.data.rig import LogInfo
from fbench.replay.runs.folder import FrameRecord
from fbench.replay.runs.manifest import (
    FrameEntry,
    InputEntry,
    LogEntry,
    Manifest,
    TruthEntry,
    load_manifest,
    save_manifest,
)
from fbench.replay.runs.redaction import public_name, public_pipeline, redact_manifest, redact_record, redact_rows


@pytest.mark.parametrize(
    ("text", "public"),
    [
        ("lidar3d", "lidar3d"),
        ("exec:/home/jane/bin/stack --map /home/jane/ulm.osm", "exec:stack"),
        ("exec:python3 jane.py", "exec:python3"),
        ("exec:", "exec:"),
        ("mine.py:Mine", "mine.py:Mine"),
        ("recorded:/objects", "recorded:/objects"),
    ],
)
def test_of_a_command_the_program_is_left(text, public):
    assert public_pipeline(text) == public


def test_the_name_of_a_log_tells_only_which_logs_are_the_same():
    names = [public_name(LogInfo(name, id_)) for name, id_ in (("a", "ulm"), ("b", "ulm"), ("a", "bonn"))]
    assert names[0] == names[1] != names[2]
    assert "ulm" not in names[0]
    assert len(names[0]) == 12


def manifest(**parameters):
    return Manifest(
        complete=True, log=LogEntry(name="ulm", log_id="ulm", digest="d", metadata={"driver": "Jane"}), pipeline="exec",
        parameters=parameters, frames=FrameEntry(reference="lidar", timeout_ns=1, tolerance_ns=1, max_gap_ns=1),
        inputs=[InputEntry(role="rig", name="jane.toml", digest="s")], mounts={}, cameras={}, num_frames=1,
        num_segments=1, digest="d", versions={},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "left"),
    [
        ("command", "/home/jane/stack --fast", "stack"),
        ("exec.command", "python3 jane.py", "python3"),
        ("command", "", ""),
        ("command", "'/home/jane doe/stack' x", "stack"),
        ("map", "/home/jane/ulm.osm", "redacted"),
        ("map", "C:\\jane\\ulm.osm", "redacted"),
        ("weights", {"file": "jane.onnx", "sha256": "s"}, {"sha256": "s"}),
        ("many", [{"file": "jane.onnx", "sha256": "s"}, "/a/b"], [{"sha256": "s"}, "redacted"]),
        ("mode", "car pedestrian", "car pedestrian"),
        ("eps_m", 0.5, 0.5),
        ("none", None, None),
    ],
)
def test_parameters(key, value, left):
    assert redact_manifest(manifest(**{key: value})).parameters == {key: left}


def test_files_and_metadata_lose_their_names(tmp_path):
    full = manifest().model_copy(update={"truth": TruthEntry(name="jane.csv", format="csv", digest="d")})
    save_manifest(tmp_path / "manifest.json", redact_manifest(full))
    read = load_manifest(tmp_path / "manifest.json")
    assert read.redacted
    assert read.log.metadata == {}
    assert read.inputs == [InputEntry(role="rig", name="", digest="s")]
    assert read.truth == TruthEntry(name="", format="csv", digest="d")
    save_manifest(tmp_path / "manifest.json", read)  # as scoring does with other truth
    assert load_manifest(tmp_path / "manifest.json") == read


def test_texts_of_frames():
    missing = {"a": "never came", "b": "late by 12.3 ms", "c": "no jane.onnx", "d": "no /home", "e": "skipped: 4x3"}
    record = FrameRecord(0, 1, 0, None, missing, "d", "c", "ValueError: /home/jane (jane.py:3)")
    redacted = redact_record(record)
    assert redacted.failed == "ValueError"
    assert redacted.missing == {**missing, "c": "redacted", "d": "redacted"}
    assert redact_record(redacted) == redacted


def test_places_of_faults_go_and_counts_stay():
    assert redact_rows([{"code": "A", "count": 3, "places": ["/home"]}]) == [{"code": "A", "count": 3, "places": []}]
