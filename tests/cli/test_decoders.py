"""Decoders on the command line: every command that opens a log takes them, and only where the user names them."""

import json
import textwrap
from importlib.metadata import EntryPoint

import pytest
from mcap.writer import Writer

from fbench.api import LogRequest, ReplayRequest, replay
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.replay.contracts import entry_points

DECODER = '''
"""Radar of ACME."""
import json
import numpy as np
from fbench.replay.contracts.decoders import decodes
from fbench.replay.data.messages import RadarScan

print("hello from the import")

@decodes("acme.Targets", kind="radar")
def targets(payload):
    """Targets, as (x, y, speed)."""
    print("hello")
    rows = np.array(json.loads(payload.data)["targets"], np.float32).reshape(-1, 3)
    xyz = np.stack([rows[:, 0], rows[:, 1], 0 * rows[:, 0]], axis=1)
    return RadarScan("front", payload.log_ns - 5_000_000, 0, xyz, rows[:, 2])

def plain(payload):
    return None
'''
LABELS = """
import numpy as np
from fbench.replay.contracts.decoders import decodes
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth

@decodes("foxglove.SceneUpdate", kind="boxes")
def labels(payload):
    print("hello")
    boxes = Boxes3D(np.array([[25.0, 0, 1]]), np.array([[4.0, 2, 1.5]]), np.zeros(1), label=np.array(["car"]),
                    track_id=np.array([7]))
    return Truth(payload.publish_ns, 0, boxes)
"""
TF = {
    "parent_frame_id": "base_link", "child_frame_id": "front", "translation": {"x": 3, "y": 0, "z": 0.5},
    "rotation": {"x": 0, "y": 0, "z": 0, "w": 1},
}  # fmt: skip


@pytest.fixture
def acme(tmp_path):
    """A log of ten scans in `drive`, and the decoder beside it."""
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "acme.py").write_text(textwrap.dedent(DECODER))
    with (folder / "acme.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        transform = writer.register_schema("foxglove.FrameTransform", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/tf_static", "json", transform), 10**9, json.dumps(TF).encode(), 0)
        channel = writer.register_channel("/radar", "json", writer.register_schema("acme.Targets", "jsonschema", b"{}"))
        for i in range(10):
            data = {"targets": [[12 + i, 0.5 * k, 10] for k in range(4)]}
            writer.add_message(channel, 10**9 + 50_000_000 * i, json.dumps(data).encode(), 10**9)
        writer.finish()
    return folder


BY_FILE = ("--decoder", "drive/acme.py:targets")


def test_without_it_the_topic_is_of_no_use(fbench, acme):
    result = fbench("log", "info", "drive/acme.mcap", "--json")
    assert {topic["topic"]: topic["kind"] for topic in result.json()["topics"]} == {
        "/radar": "",
        "/tf_static": "transform",
    }


def test_init_names_what_it_cannot_read_and_what_helps(fbench, acme):
    result = fbench("init", "drive/acme.mcap")
    assert (result.code, result.err.count("\n")) == (3, 1)
    assert "only /radar (acme.Targets); a decoder plug-in reads other types (--decoder)" in result.err


@pytest.mark.parametrize(
    ("command", "code"),
    [
        (("log", "info", "drive/acme.mcap"), 0),
        (("log", "check", "drive/acme.mcap"), 0),
        (("log", "preview", "drive/acme.mcap"), 0),
        (("log", "convert", "drive/acme.mcap", "-o", "own.mcap", "--decode"), 0),
        (("init", "drive/acme.mcap"), 0),
        (("replay", "drive/acme.mcap", "-p", "radar3d"), 0),
    ],
)
def test_every_command_that_opens_a_log_takes_it(fbench, acme, command, code):
    result = fbench(*command, *BY_FILE, "--json")
    assert result.code == code, result.err
    assert result.out.startswith("{")  # nothing that it prints is between the lines of JSON
    assert "hello" in result.err
    if command[-1] == "--decode":
        assert fbench("log", "info", "own.mcap").out.count("radar") >= 1
    if command[0] == "replay":
        manifest = json.loads((acme.parent / "runs/acme-radar3d/manifest.json").read_text())
        assert manifest["num_frames"] == 10
        [entry] = manifest["inputs"]
        assert (entry["role"], entry["name"], len(entry["digest"])) == ("decoder", "acme.py:targets", 32)


def test_truth_as_a_decoder_reads_it_is_exported(fbench, log, tmp_path):
    (tmp_path / "labels.py").write_text(LABELS)
    result = fbench(
        "log", "export", log, "--format", "kitti-tracking", "-o", "out", "--json", "--decoder", "labels.py:labels"
    )  # fmt: skip
    assert result.code == 0, result.err
    assert result.json()["sequences"][0]["rows"] == 6
    rows = [line.split() for line in (tmp_path / "out" / "car.txt").read_text().splitlines()]
    assert {(row[1], float(row[15])) for row in rows} == {("7", 25.0)}  # track, and z of the camera


@pytest.mark.slow
def test_verify_hands_it_to_its_processes(fbench, acme, circumstances):
    circumstances("hash seed")
    result = fbench("verify", "drive/acme.mcap", "-p", "radar3d", "--quick", *BY_FILE, "--json")
    assert (result.code, result.json()["identical"]) == (0, True)


@pytest.mark.slow
def test_suites_hand_it_to_their_processes_and_know_its_content(acme, monkeypatch):
    monkeypatch.chdir(acme.parent)

    def states():
        log = LogRequest(acme / "acme.mcap", decoder=[f"{acme / 'acme.py'}:targets"])
        return [
            result.state
            for result in run_suite([ReplayRequest(log, "radar3d", out=acme.parent / "run")], RunOptions(1))
        ]

    assert states() == ["replayed"]
    assert states() == ["there"]
    (acme / "acme.py").write_text((acme / "acme.py").read_text() + "# changed\n")
    assert states() == ["replayed"]


def test_a_request_of_python(acme, monkeypatch):
    monkeypatch.chdir(acme.parent)
    request = ReplayRequest(LogRequest(acme / "acme.mcap", decoder=("drive/acme.py:targets",)), "radar3d")
    again = ReplayRequest.from_json(request.absolute().to_json())
    assert again.log.decoder == [f"{acme / 'acme.py'}:targets"]
    assert replay(again).run.manifest.num_frames == 10


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("drive/acme.py:target", "acme.py: has no function 'target' below @decodes(TYPE, kind=KIND); did you mean"),
        ("drive/acme.py:plain", "has no function 'plain' below @decodes"),
        ("drive/no.py:targets", "drive/no.py: no such file"),
        ("acme", "unknown decoder 'acme'; there are none"),
        ("drive/bad.py:targets", "drive/bad.py: can't be imported: ZeroDivisionError: division by zero (bad.py:1)"),
        ("drive/other.py:x", "--decoder other.py:x: the log has no acme.Target; did you mean 'acme.Targets'?"),
    ],
)
def test_what_cannot_be_used_is_one_line(fbench, acme, name, text):
    (acme / "bad.py").write_text("1 / 0\n")
    (acme / "other.py").write_text(
        "from fbench.replay.contracts.decoders import decodes\nx = decodes('acme.Target', kind='radar')(print)\n"
    )
    result = fbench("log", "info", "drive/acme.mcap", "--decoder", name)
    told = result.err.removeprefix("hello from the import\n")
    assert (result.code, told.count("\n")) == (2, 1), result.err
    assert text in told


def test_it_needs_decode_where_a_log_is_converted(fbench, acme):
    result = fbench("log", "convert", "drive/acme.mcap", "-o", "own.mcap", *BY_FILE)
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert "--decoder change what is decoded: give --decode too" in result.err


def test_init_writes_it_and_a_file_runs_only_where_the_user_names_it(fbench, acme):
    assert fbench("init", "drive/acme.mcap", *BY_FILE).code == 0
    assert 'decoder = ["acme.py:targets"]' in (acme / "fbench.toml").read_text()
    result = fbench("log", "info", "drive/acme.mcap")
    assert (result.code, result.err.count("\n")) == (2, 1)
    assert "'acme.py:targets' is a program, which only runs where you name it; give --config" in result.err
    assert "hello" not in result.err
    for named in (("--config", "drive/fbench.toml"), BY_FILE):
        rows = fbench("log", "info", "drive/acme.mcap", "--json", *named).json()["streams"]
        assert [(row["sensor"], row["kind"]) for row in rows] == [("radar", "radar")]


def test_init_says_where_a_file_lies_outside_of_the_folder(fbench, acme):
    (acme / "acme.py").rename(acme.parent / "acme.py")
    assert fbench("init", "drive/acme.mcap", "--decoder", "acme.py:targets").code == 0
    assert '\n# decoder = ["acme.py:targets"]  # outside of this folder' in (acme / "fbench.toml").read_text()


@pytest.mark.parametrize("name", ["../acme.py:targets", "/acme.py:targets"])
def test_a_configuration_names_no_file_outside_of_its_folder(fbench, acme, name):
    (acme / "fbench.toml").write_text(f'version = 1\ndecoder = ["{name}"]\n')
    result = fbench("log", "info", "drive/acme.mcap", "--config", "drive/fbench.toml")
    assert result.code == 2
    assert "lies outside of its folder" in result.err


def test_packages_provide_them_by_entry_points(fbench, acme, monkeypatch):
    monkeypatch.syspath_prepend(str(acme))
    point = EntryPoint("acme-radar", "acme:targets", "fbench.decoders")
    monkeypatch.setattr(entry_points, "find_installed", lambda group: [point] if group == "decoders" else [])
    result = fbench("plugins", "decoders")
    assert "decoders  acme-radar  acme:targets" in result.out
    assert "foxglove.PointCloud" in result.out
    result = fbench("plugins", "decoders", "acme-radar")
    assert "Targets, as (x, y, speed)." in result.out
    assert "acme.Targets" in result.out
    (acme / "fbench.toml").write_text('version = 1\ndecoder = ["acme-radar"]\n')  # installed ones need no more
    rows = fbench("log", "info", "drive/acme.mcap", "--json").json()["streams"]
    assert [(row["sensor"], row["kind"]) for row in rows] == [("front", "radar")]
