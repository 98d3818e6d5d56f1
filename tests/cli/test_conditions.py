"""`--condition` on every command that takes it, and `fbench plugins conditions`."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from tests.cli.conftest import messages, rig, write_log

from fbench.api.verify_child import run
from fbench.replay.check.difference import Outcome, VerifyTask, first_difference
from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.entry_points import entry_points_of
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.street import Street
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud
from fbench.replay.logs.open import open_log
from fbench.replay.runs.digest import digest
from fbench.replay.runs.folder import Run
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

DUST = str(Path(__file__).resolve().parents[2] / "examples" / "dust.py")
PLUGIN = """
from dataclasses import replace
import numpy as np

class Brighter:
    '''Adds levels to every pixel.'''
    version, kinds, levels = 2, ("camera",), {"gray_levels": (1.0, 2.0, 3.0, 4.0, 5.0)}

    def disturb(self, message, level, site):
        pixels = np.frombuffer(message.data, np.uint8) + np.uint8(level["gray_levels"])
        return [replace(message, data=pixels.tobytes())]

class Writes:
    version, kinds, levels = 1, ("lidar",), {"x": (1, 2, 3, 4, 5)}

    def disturb(self, message, level, site):
        message.xyz[:] = 0
        return [message]

class Early(Writes):
    def disturb(self, message, level, site):
        return [replace(message, log_ns=0)]

class Other(Writes):
    def disturb(self, message, level, site):
        return ["nothing"]
"""


@pytest.fixture
def plugin(tmp_path):
    (tmp_path / "mine.py").write_text(PLUGIN)
    return "mine.py"


@pytest.mark.parametrize(
    ("condition", "code", "words"),
    [
        ("fogg:3", 2, "unknown condition 'fogg'; did you mean 'fog'?"),
        ("fog:6", 2, "'fog:6': expected a severity of 0 to 5"),
        ("loss:3@9s-", 2, "the window begins after the log, which lasts 0.502 s"),
        ("loss.lidar_top:3", 2, "the log has no such sensor; it has: camera, lidar, radar"),
        ("loss:25mmh", 2, "or a value such as 20%"),
        ("rain:9999mmh", 2, "--condition rain:9999mmh: Weather.rain_mm_h: expected 0 to 300"),
        ("radar.resolution:0m", 2, "condition 'radar.resolution': expected cells above 0 m"),
        ("clock_jump:99999999999s", 3, "condition 'clock_jump' set a time beyond the year 2116"),
        ("none.toml", 2, "none.toml: no such file"),
        ("mine.py:Nothing", 2, "has no class 'Nothing'"),
        ("mine.py:Writes", 3, "condition 'mine.py:Writes' failed: ValueError: assignment destination is read-only"),
        ("mine.py:Early", 3, "condition 'mine.py:Early' delivered a message"),
        ("mine.py:Other", 3, "condition 'mine.py:Other' gave str for PointCloud"),
    ],
)
@pytest.mark.parametrize("command", ["replay", "convert"])
def test_bad_input_is_one_line(fbench, log, plugin, tmp_path, command, condition, code, words):
    replay, convert = ("replay", log, "-p", "lidar3d", "-o", "out"), ("log", "convert", log, "-o", "out.mcap")
    result = fbench(*(replay if command == "replay" else convert), "--condition", condition)
    assert result.code == code
    assert words in result.err
    assert len(result.err.strip().splitlines()) == 1
    assert {p.name for p in tmp_path.iterdir()} <= {"car.mcap", "mine.py", "__pycache__"}


def test_verify_says_what_replay_says_of_a_condition_that_fails(fbench, log, plugin):
    options = (log, "-p", "lidar3d", "--condition", "mine.py:Other")
    result = fbench("verify", *options)
    assert (result.code, result.err) == (3, fbench("replay", *options).err)
    assert result.err.endswith(" [COR001]\n")


def test_a_log_without_truth_cant_have_its_objects_disturbed(fbench, tmp_path):
    write_log(tmp_path / "bare.mcap", messages())
    result = fbench("replay", "bare.mcap", "-p", "lidar3d", "--condition", "object.moved:3")
    assert result.code == 3
    assert "condition object.moved:3 needs 3D truth in body coordinates; the log has none" in result.err


def test_a_seed_out_of_range(fbench, log):
    assert "--seed -1: expected 0 to 2^63 - 1" in fbench("replay", log, "-p", "lidar3d", "--seed", "-1").err


def test_a_run_says_what_disturbed_it(fbench, log, tmp_path):
    condition = "loss.radar:4+object.cutout.lidar:2@0.1s-0.4s+extrinsic.camera:5"
    result = fbench("replay", log, "-p", "lidar3d", "--condition", condition, "--seed", "4", "--report")
    assert result.code == 0, result.err
    folder = tmp_path / "runs" / "car-lidar3d-loss.radar-4-object.cutout.lidar-2-0.1s-0.4s-extrinsic.camera-5"
    for line in (
        r"^conditions: loss.radar:4, object.cutout.lidar:2 \(0.1s-0.4s\), extrinsic.camera:5; seed 4$",
        r"^changed: camera: mount 3° and 0.5 m off$",
        r"^changed: lidar: 3 of 6 messages changed, -\d+.\d % points$",
        r"^changed: radar: (\d) of 6 messages changed, \1 lost$",
    ):
        assert re.search(line, result.out, re.MULTILINE), line
    manifest = json.loads((folder / "manifest.json").read_text())
    assert [entry["name"] for entry in manifest["conditions"]] == ["loss", "object.cutout", "extrinsic"]
    assert manifest["seed"] == 4
    page = (folder / "report.html").read_text()
    for text in (
        "<h2>Conditions</h2>",
        "object.cutout.lidar:2 (0.1s-0.4s)",
        "removed_share 0.4",
        "with seed 4",
        "mount 3°",
    ):
        assert text in page
    clear = fbench("replay", log, "-p", "lidar3d", "--report", "-o", "clear")
    assert "changed:" not in clear.out
    assert "Conditions</h2>" not in (tmp_path / "clear" / "report.html").read_text()


def test_a_converted_log_gives_the_frames_of_the_replay_under_the_condition(fbench, log, plugin, tmp_path):
    condition = f"object.density:3+{DUST}:Dust:2+mine.py:Brighter:5+clock_jump.radar:2"
    result = fbench("log", "convert", log, "-o", "given.mcap", "--condition", condition, "--seed", "3")
    assert result.code == 0, result.err
    assert "changed: camera: 6 of 6 messages changed, pixels 5 gray levels off on average" in result.out
    assert fbench("replay", log, "-p", "lidar3d", "--condition", condition, "--seed", "3", "-o", "under").code == 0
    assert fbench("replay", "given.mcap", "-p", "lidar3d", "-o", "given").code == 0
    assert fbench("replay", log, "-p", "lidar3d", "-o", "clear").code == 0
    first, second, clear = (Run(tmp_path / name) for name in ("under", "given", "clear"))
    assert [f.digest for f in first.frames] == [f.digest for f in second.frames]
    assert [f.digest for f in first.frames] != [f.digest for f in clear.frames]
    about = open_log(tmp_path / "given.mcap", FaultLog()).info
    assert about.log_id.startswith("test-1-")
    assert about.metadata["conditions"] == "object.density:3+dust.py:Dust:2+mine.py:Brighter:5+clock_jump.radar:2"
    assert about.metadata["conditions.seed"] == "3"


def test_images_of_a_converted_log_are_exact_and_truth_and_recorded_times_stay(fbench, log, plugin, tmp_path):
    assert fbench("log", "convert", log, "-o", "given.mcap", "--condition", "mine.py:Brighter:5@0.2s-").code == 0
    old, new = (open_log(tmp_path / name, FaultLog()) for name in ("car.mcap", "given.mcap"))
    before, after = ([m for m in reader.messages() if isinstance(m, Image)] for reader in (old, new))
    assert [m.encoding for m in after] == ["jpeg", "jpeg", "png", "png", "png", "png"]
    assert [(m.stamp_ns, m.log_ns) for m in after] == [(m.stamp_ns, m.log_ns) for m in before]
    assert (decode(after[3]).astype(int) - decode(before[3]) == 5).all()
    assert after[1].data == before[1].data
    centers = [[t.boxes3d.center_m.tolist() for t in reader.truths()] for reader in (old, new)]
    assert centers[0] == centers[1]


def test_times_and_calibration_of_a_converted_log(fbench, log, tmp_path):
    condition = "delay.lidar:5+offset.radar:3+dropout.camera:5+extrinsic.lidar:2"
    assert fbench("log", "convert", log, "-o", "given.mcap", "--condition", condition).code == 0
    old, new = (open_log(tmp_path / name, FaultLog()) for name in ("car.mcap", "given.mcap"))
    clouds = [[m for m in reader.messages() if isinstance(m, PointCloud)] for reader in (old, new)]
    assert [b.log_ns - a.log_ns for a, b in zip(*clouds, strict=True)] == [500_000_000] * 6
    assert new.num_messages["radar"] == 6
    assert new.num_messages.get("camera", 0) == 0
    assert np.linalg.norm(new.rig.mounts["lidar"].translation_m) == pytest.approx(0.05)
    assert new.rig.mounts["radar"].equals(rig().mounts["radar"])
    logs = [m.log_ns for m in new.messages()]
    assert logs == sorted(logs)


def test_a_converted_log_can_be_disturbed_again_but_not_cut(fbench, log, tmp_path):
    fbench("log", "convert", log, "-o", "a.mcap", "--condition", "loss.radar:2")
    fbench("log", "convert", "a.mcap", "-o", "b.mcap", "--condition", "offset.radar:1")
    about = open_log(tmp_path / "b.mcap", FaultLog()).info
    assert about.metadata["conditions"] == "loss.radar:2+offset.radar:1"
    refused = fbench("log", "convert", log, "-o", "c.mcap", "--condition", "loss:2", "--from", "0.1")
    assert refused.code == 2
    assert "--condition disturbs a whole log" in refused.err
    clear = fbench("log", "convert", log, "-o", "d.mcap", "--condition", "loss:0")
    assert "id: test-1\n" in clear.out


@pytest.mark.slow
def test_a_preview_shows_before_and_after(fbench, log, tmp_path):
    assert fbench("log", "preview", log, "-o", "clear", "--num", 2).code == 0
    result = fbench("log", "preview", log, "-o", "dust", "--num", 2, "--condition", f"{DUST}:Dust:5+dropout.camera:5")
    assert result.code == 0, result.err
    assert re.search(r"^changed: lidar: 6 of 6 messages changed, -\d", result.out, re.MULTILINE)
    one, both = (cv2.imread(str(tmp_path / name / "000000-above.png")) for name in ("clear", "dust"))
    width = one.shape[1]
    assert both.shape[1] == 2 * width + 4
    assert (both[:, :width] == one).all()
    assert (both[:, width + 4 :] != one).any()
    lost = cv2.imread(str(tmp_path / "dust" / "000000-0-camera-lidar.png"))
    assert (lost[:, lost.shape[1] // 2 + 2 :] == 128).all()  # there is no image then
    sheet = (tmp_path / "dust" / "index.html").read_text()
    assert "dust.py:Dust:5+dropout.camera:5; seed 0" in sheet
    assert "Left as recorded, right under conditions." in sheet
    assert "Left as recorded" not in (tmp_path / "clear" / "index.html").read_text()


def test_conditions_are_listed_and_described(fbench, plugin, monkeypatch):
    monkeypatch.setenv("COLUMNS", "150")
    listed = fbench("plugins", "conditions").out
    assert re.search(r"^fog +camera, lidar, radar +visibility_m 599, 300, 150, 100, 50 *$", listed, re.MULTILINE)
    shown = fbench("plugins", "conditions", "lidar.fog").out
    assert "extinction ln(20) / MOR" in shown
    assert "sensors: lidar\n" in shown
    assert re.search(r"^severity +1 +2 +3 +4 +5$", shown, re.MULTILINE)
    assert re.search(r"^visibility_m +599 +300 +150 +100 +50$", shown, re.MULTILINE)
    assert "needs: calibration" in fbench("plugins", "conditions", "intrinsic").out
    mine = fbench("plugins", "conditions", "mine.py:Brighter").out
    assert "Adds levels to every pixel." in mine
    refused = fbench("plugins", "conditions", "lidar.fogg")
    assert (refused.code, "did you mean" in refused.err) == (2, True)


HIDING = {"camera.crash", "camera.quant", "dropout", "lidar.fov"}
"""Conditions that leave little for others to change."""


def change(street, parts, seed):
    """The rig and the messages that become of a street."""
    disturbance = Disturbance(parse_conditions("+".join(parts)), seed, street.span)
    messages = DisturbedReader(street, disturbance, Effects()).messages()
    return [digest(disturbance.rig(street.rig, street.info.log_id)), *map(digest, messages)]


@pytest.mark.slow
def test_verify_holds_under_every_condition(tmp_path):
    """What `fbench verify` compares, in this process: frames, messages, boxes, faults and scores of a paced replay of
    the log as Parquet, all of it read in advance, are those of the log itself. Three conditions at a time, of different
    sensors mostly, none of which hides what another does; `test_every_condition` reads messages under each alone.
    """
    street, names = Street(6), sorted(entry_points_of("conditions"))
    log = write_log(tmp_path / "street.mcap", [*street.messages(), *street.truths()], street.rig)
    num = -(-len(names) // 3)
    for some in (names[i::num] for i in range(num)):
        parts, folder = [f"{name}:4" + ("@0.3s-" if name in HIDING else "") for name in some], tmp_path / some[0]
        condition, whole = "+".join(parts), change(street, parts, seed=3)
        without = {
            name: change(street, [p for p in parts if p != own], seed=3) for name, own in zip(some, parts, strict=True)
        }
        assert [name for name in some if without[name] == whole] == []
        request = ReplayRequest(LogRequest(log), "late3d", condition=condition, seed=3, on_fault="tolerant")
        paced = replace(request, rate="20", read_ahead="all")
        run(VerifyTask(request, folder / "base"))
        run(VerifyTask(paced, folder / "other", form="parquet"))
        base, other = (Outcome(folder / which) for which in ("base", "other"))
        assert (some, first_difference(base, other, same_container=False)) == (some, None)
        assert len(base.run.frames) == 6
        assert base.run.manifest.effects


@pytest.mark.slow
def test_verify_holds_under_all_conditions_together_in_fresh_processes(fbench, tmp_path, circumstances):
    """Each acts at its lowest severity, those that hide what others did in the second half alone."""
    street = Street(8)
    log = write_log(tmp_path / "street.mcap", [*street.messages(), *street.truths()], street.rig)
    circumstances("random hash seed", "2 threads", "Parquet")  # of 12
    names = sorted(entry_points_of("conditions"), key=lambda name: (name in HIDING, name))
    condition = "+".join(f"{name}:1" + ("@0.4s-" if name in HIDING else "") for name in names)
    result = fbench("verify", log, "-p", "late3d", "--condition", condition, "--seed", "5", "--keep", "runs")
    assert result.code == 0, result.out + result.err
    assert result.out.count(": identical\n") == 3
    effects = Run(tmp_path / "runs" / "reference").manifest.effects
    assert all(row["changed"] > 0 and "unused" not in row for row in effects.values())
    assert effects.keys() == {"camera", "lidar", "radar"}


@pytest.mark.slow
def test_verify_holds_under_conditions(fbench, log, tmp_path, circumstances, in_this_process):
    """In other folders, containers, orders of reading, and processes."""
    condition = "dust.py:Dust:3+delay.lidar:4+loss:3+extrinsic:2+object.occlusion:3"
    circumstances("hash seed", "2 threads", "no read-ahead", "other time", "MCAP in small chunks", "Parquet")
    in_this_process("no_read-ahead", "MCAP", "Parquet")
    (tmp_path / "dust.py").write_text(Path(DUST).read_text())
    result = fbench("verify", log, "-p", "lidar3d", "--condition", condition, "--seed", "5")
    assert result.code == 0, result.out + result.err
