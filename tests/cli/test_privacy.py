"""What must not reach a run, a report or the terminal: credentials always, more with --no-media and --redact."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from tests.cli import conftest as c

from fbench.api.replays import keep_stderr
from fbench.cli import main
from fbench.metrics.criticality.scores import RULES
from fbench.metrics.events.scores import SLICE
from fbench.replay.data.messages import Pose
from fbench.replay.data.rig import Mount

URL = "https://user:hush@host/x?X-Amz-Signature=HUSH"
METADATA = {
    "source": URL, "token": "HUSH", URL: "key", "notes": "s3:/key:hush@bucket/k --password HUSH", "driver": "Jane Doe",
    "reference": "lidar", "radar.velocity_period_mps": "30",
}  # fmt: skip

LEAKY = """
from dataclasses import dataclass
from pathlib import Path
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.frames import Fault, Output
import numpy as np

@dataclass(frozen=True)
class Params:
    api_key: str = ""
    source: str = ""
    weights: Path | None = None

class Leaky:
    def __init__(self, params: Params):
        self.params = params
    def start(self, rig, log_info):
        assert "HUSH" not in str(log_info)
    def reset(self, reason):
        pass
    def step(self, frame):
        if frame.index == 1:
            raise ValueError("can't load https://user:hush@host/m.onnx?sig=HUSH to /home/jane/m.onnx")
        boxes = Boxes3D(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), label=np.zeros(0, str))
        fault = Fault("DEC002", "AWS_SECRET_ACCESS_KEY=HUSH at /home/jane")
        return Output(boxes, boxes, {}, (fault,), {"camera": "no /home/jane/x.onnx with --token HUSH"})
"""

JPEG = "/9j/4AAQ"
"""How JPEG data begin in base64."""


def everything(folder):
    """All bytes of a folder, Parquet files unpacked."""
    parts = []
    for path in sorted(folder.rglob("*")):
        if path.suffix == ".parquet":
            parts.append(str(pq.read_table(path).to_pydict()) + str(pq.read_schema(path).metadata))
        elif path.is_file():
            parts.append(path.read_bytes().decode("utf-8", "replace"))
        parts.append(path.name)
    return "\n".join(parts)


def assert_clean(*texts):
    for text in texts:
        assert "hush" not in text.lower()


@pytest.fixture
def leaky(tmp_path):
    (tmp_path / "mine.py").write_text(LEAKY)
    return "mine.py:Leaky"


def test_metadata_of_a_log(fbench, tmp_path):
    log = c.write_log(tmp_path / "car.mcap", [*c.messages(), *c.truths()], metadata=METADATA)
    result = fbench("replay", log, "-p", "lidar3d", "--report", "--json")
    assert result.code == 0, result.err
    assert_clean(everything(tmp_path / "runs"), result.out, result.err, fbench("log", "info", log).out)
    metadata = result.json()["manifest"]["log"]["metadata"]
    assert metadata["source"] == "https://host/x"
    assert (metadata["token"], metadata["notes"]) == ("***", "s3:/bucket/k --password ***")


def test_metadata_enter_no_digest_with_secrets(fbench, tmp_path):
    digests = []
    for secret in ("hush", "other"):
        told = {key.replace("hush", secret): text.replace("hush", secret) for key, text in METADATA.items()}
        log = c.write_log(tmp_path / "car.mcap", [*c.messages(), *c.truths()], metadata=told)
        manifest = fbench("replay", log, "-p", "lidar3d", "--json", "--overwrite").json()["manifest"]
        digests.append((manifest["digest"], manifest["log"]["digest"], manifest["log"]["log_id"]))
    assert digests[0] == digests[1]


def test_what_a_plug_in_says(fbench, log, leaky, tmp_path):
    (tmp_path / "w.onnx").touch()
    result = fbench(
        "replay", log, "-p", leaky, "--set", "api_key=HUSH", "--set", f"source={URL}", "--set", "weights=w.onnx",
        "--report", "--on-fault", "tolerant",
    )  # fmt: skip
    run = tmp_path / "runs/car-mine-Leaky"
    text = everything(run)
    assert_clean(text, result.out, result.err)
    assert "can't load https://host/m.onnx to /home/jane/m.onnx" in text
    assert json.loads((run / "manifest.json").read_text())["parameters"]["api_key"] == "***"


def test_what_a_failing_plug_in_says(fbench, log, leaky):
    result = fbench("replay", log, "-p", leaky, "--frames", "1")
    assert result.code == 3
    assert "https://host/m.onnx" in result.err
    assert_clean(result.out, result.err)


def test_tracebacks_hold_none_either(log, leaky, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["fbench", "--debug", "replay", str(log), "-p", leaky, "--frames", "1"])
    with pytest.raises(SystemExit):
        main()
    captured = capsys.readouterr()
    assert captured.err.count("Traceback") >= 2
    # The line of code that raised is the user's own file.
    assert_clean(captured.out, *(line for line in captured.err.splitlines() if "raise ValueError" not in line))


@pytest.mark.parametrize(
    "args",
    [
        ("replay", "https://user:hush@host/a.mcap?sig=HUSH", "-p", "lidar3d"),
        ("log", "info", "https://user:hush@host/a.mcap?sig=HUSH"),
        ("replay", "car.mcap", "-p", "https://user:hush@host/mine.py:Mine"),
        ("replay", "car.mcap", "-p", "exec:./none --token HUSH https://user:hush@host"),
        ("replay", "car.mcap", "-p", "lidar3d", "--set", "api_key=HUSH"),
        ("replay", "car.mcap", "-p", "lidar3d", "--set", "lidar.cluster.eps_m=https://user:hush@host"),
        ("replay", "car.mcap", "-p", "lidar3d", "--topics", "https://user:hush@host?a=HUSH"),
        ("replay", "car.mcap", "-p", "lidar3d", "--rig", "https://user:hush@host/rig.toml?a=HUSH"),
        ("replay", "car.mcap", "-p", "lidar3d", "--rate", "https://user:hush@host"),
        ("replay", "car.mcap", "--password=HUSH"),
        ("score", "s3://key:hush@bucket/run?a=HUSH"),
    ],
)
def test_errors(fbench, log, args):
    del log
    result = fbench(*args)
    assert result.code in (2, 3)
    assert result.err.startswith("fbench: ")
    assert_clean(result.out, result.err)


class Talks:
    def stderr(self):
        return b"\xff token=HUSH, https://user:hush@host/x?sig=HUSH\n"


def test_what_a_program_says(tmp_path):
    keep_stderr(Talks(), tmp_path)
    assert (tmp_path / "stderr.txt").read_bytes() == b"\xff token=***, https://host/x\n"


def test_a_log_whose_path_was_a_url(fbench, log, tmp_path):
    folder = tmp_path / "https:/user:hush@host"
    folder.mkdir(parents=True)
    path = log.rename(folder / "car.mcap?X-Amz-Signature=HUSH.HUSH")
    result = fbench("replay", path, "-p", "lidar3d", "--report", "--json")
    assert result.code == 0, result.err
    assert_clean(everything(tmp_path / "runs"), result.out, result.err)
    assert (tmp_path / "runs/car.mcap-lidar3d").is_dir()


def test_a_sensor_with_credentials_in_its_name_is_refused(fbench, tmp_path):
    name = "rtsp://admin:hush@10.0.0.5/1"
    rig = c.rig(camera=False)
    rig = replace(rig, mounts={name: Mount("lidar", np.zeros(3), c.UPRIGHT), "radar": rig.mounts["radar"]})
    items = [replace(m, sensor=name) if m.sensor == "lidar" else m for m in c.messages(camera=False)]
    result = fbench("replay", c.write_log(tmp_path / "car.mcap", items, rig), "-p", "lidar3d")
    assert result.code == 3
    assert "sensor 'rtsp://10.0.0.5/1' has credentials" in result.err
    assert_clean(result.out, result.err)


def test_no_media(fbench, log, tmp_path):
    assert fbench("replay", log, "-p", "lidar3d", "-o", "plain").code == 0
    result = fbench("replay", log, "-p", "lidar3d", "-o", "bare", "--no-media", "--report")
    assert result.code == 0, result.err
    assert pq.read_table(tmp_path / "plain/media.parquet").num_rows > 0
    assert pq.read_table(tmp_path / "bare/media.parquet").num_rows == 0
    report = (tmp_path / "bare/report.html").read_text()
    assert JPEG not in report
    names = ("manifest.json", "detections.parquet", "scores.json", "frames.parquet")
    for name in names:
        assert (tmp_path / "plain" / name).read_bytes() == (tmp_path / "bare" / name).read_bytes()


def poses():
    for i in range(8):
        stamp = 900_000_000 + 100 * c.MS * i
        yield Pose("pose", stamp, stamp, np.array([123456.25 + i, 654321.25, 0]), c.UPRIGHT)


def test_redacted(fbench, leaky, tmp_path):
    (tmp_path / "janes_weights.onnx").write_text("x")
    (tmp_path / "rig_of_jane.toml").write_text(
        "[sensors.radar]\ntranslation_m = [1, 0, 0]\nrotation_xyzw = [0, 0, 0, 1]\n"
    )
    log = c.write_log(tmp_path / "jane_in_ulm.mcap", [*c.messages(), *c.truths(), *poses()], metadata=METADATA)
    args = ("replay", log, "-p", leaky, "--set", "weights=janes_weights.onnx", "--set", "source=/home/jane/x",
            "--rig", "rig_of_jane.toml", "--on-fault", "tolerant")  # fmt: skip
    assert fbench(*args, "-o", "plain").code == 0
    result = fbench(*args, "--redact", "--report")
    assert result.code == 0, result.err
    run = next((tmp_path / "runs").iterdir())
    assert run.name.startswith("log-")
    assert run.name.endswith("-mine-Leaky")
    text = everything(run)
    assert "654321" in everything(tmp_path / "plain")
    for private in ("jane", "Jane", "ulm", "/home", str(tmp_path), "12345", "654321", JPEG, "test-1"):
        assert private not in text, private
    manifest, plain = (json.loads((f / "manifest.json").read_text()) for f in (run, tmp_path / "plain"))
    assert (manifest["redacted"], plain["redacted"]) == (True, False)
    assert run.name.startswith(manifest["log"]["name"])
    assert manifest["log"]["metadata"] == {"reference": "lidar", "radar.velocity_period_mps": "30"}
    assert list(manifest["parameters"]["weights"]) == ["sha256"]
    assert manifest["digest"] == plain["digest"]  # of the results, which are the same
    both = (json.loads((f / "scores.json").read_text()) for f in (tmp_path / "plain", run))
    shown, hidden = ([row for row in rows if not row["slice"].startswith(SLICE)] for rows in both)
    of_motion = {name for name, rule in RULES.items() if rule.needs}  # of the ego, which a run without poses hides
    assert [r for r in hidden if r["metric"] not in of_motion] == [r for r in shown if r["metric"] not in of_motion]
    assert {r["value"] for r in hidden if r["metric"] in of_motion} == {None}
    counts = [{r["code"]: r["count"] for r in json.loads((f / "faults.json").read_text())["rows"]}
              for f in (run, tmp_path / "plain")]  # fmt: skip
    assert counts[0] == counts[1]


def test_redacted_runs_of_one_log_have_one_name(fbench, log, tmp_path):
    other = Path(tmp_path / "copy.mcap")
    other.write_bytes(log.read_bytes())
    runs = [
        fbench("replay", path, "-p", p, "--redact", "--json").json()
        for path, p in ((log, "lidar3d"), (other, "radar3d"))
    ]
    assert runs[0]["manifest"]["log"]["name"] == runs[1]["manifest"]["log"]["name"]
    assert fbench("report", *(run["run"] for run in runs), "-o", "r.html").code == 0
