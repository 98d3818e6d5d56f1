"""Every row of the fault table that a log can cause: exit code, code, count, and no run that looks complete.

One builder a case; `ELSEWHERE` names the tests of codes that need more than a log and `lidar3d`.
"""

import json
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode
from tests.cli import conftest as c
from tests.replay.logs.other_forms import NO_SUMMARY, layout, rewrite

from fbench.replay.contracts.faults import FAULTS
from fbench.replay.data.boxes import MAX_BOXES, Boxes3D
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan, Truth
from fbench.replay.data.rig import LogInfo
from fbench.replay.logs.containers.mcap.write import McapWriter
from fbench.replay.logs.containers.parquet.write import ParquetWriter

ROOT = Path(__file__).resolve().parents[2]
HEAD = struct.Struct("<BQ")
S = 1_000_000_000


@dataclass(frozen=True)
class Case:
    """One log, and what must come of it."""

    name: str
    code: str
    build: Callable[[Path], Path]
    exit: int
    count: int = 1
    args: tuple[str, ...] = ("-p", "lidar3d", "--all-around")
    also: tuple[str, ...] = field(default=())
    """Other codes that may be met."""


def items(**more: Any) -> list[Any]:
    return [*c.messages(**more), *c.truths(**more)]


def changed(change: Callable[[list[Any]], list[Any]]) -> Callable[[Path], Path]:
    return lambda folder: c.write_log(folder / "log.mcap", change(items()))


def on_third_cloud(how: Callable[[PointCloud], PointCloud]) -> Callable[[Path], Path]:
    def change(messages: list[Any]) -> list[Any]:
        clouds = [i for i, m in enumerate(messages) if isinstance(m, PointCloud)]
        messages[clouds[2]] = how(messages[clouds[2]])
        return messages

    return changed(change)


def edited(edit: Callable[[bytearray], bytes | bytearray], **how: Any) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        path = rewrite(c.write_log(folder / "plain.mcap", items()), folder / "log.mcap", chunk_size=2000, **how)
        path.write_bytes(edit(bytearray(path.read_bytes())))
        return path

    return build


def same(data: bytearray) -> bytearray:
    return data


def chunk_flipped(data: bytearray) -> bytearray:
    chunks = [(at, length) for opcode, at, length in layout(bytes(data)) if opcode == Opcode.CHUNK]
    at, length = chunks[len(chunks) // 2]
    data[at + length // 2] ^= 1
    return data


def cut(data: bytearray) -> bytearray:
    chunks = [(at, length) for opcode, at, length in layout(bytes(data)) if opcode == Opcode.CHUNK]
    return data[: chunks[-1][0] + 20]


def end_changed(data: bytearray) -> bytearray:
    end = next(at for opcode, at, _ in layout(bytes(data)) if opcode == Opcode.DATA_END)
    data[end + HEAD.size] ^= 1
    return data


def one_chunk(compression: str, size: int, stored: bytes) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        body = struct.pack("<QQQII", 0, 1, size, 0, len(compression)) + compression.encode()
        body += struct.pack("<Q", len(stored)) + stored
        head = struct.pack("<II", 0, 0)
        magic = b"\x89MCAP0\r\n"
        record = HEAD.pack(Opcode.HEADER, len(head)) + head + HEAD.pack(Opcode.CHUNK, len(body)) + body
        (folder / "log.mcap").write_bytes(magic + record + HEAD.pack(Opcode.DATA_END, 4) + bytes(4) + magic)
        return folder / "log.mcap"

    return build


def huge_record(folder: Path) -> Path:
    path = folder / "log.mcap"
    with path.open("wb") as file:
        file.write(b"\x89MCAP0\r\n" + HEAD.pack(Opcode.MESSAGE, 300 * 2**20))
        file.truncate(301 * 2**20)
    return path


def foreign(*streams: tuple[str, str, str, list[bytes]]) -> Callable[[Path], Path]:
    """The plain log with more topics: topic, schema, encoding, payloads."""

    def build(folder: Path) -> Path:
        plain = c.write_log(folder / "plain.mcap", items())
        return rewrite(plain, folder / "log.mcap", extra=list(streams))

    return build


def unknown_channel(folder: Path) -> Path:
    path = folder / "log.mcap"
    c.write_log(path, items())
    data = rewrite(path, folder / "b.mcap", use_chunking=False, enable_data_crcs=False, **NO_SUMMARY).read_bytes()
    end = next(at for opcode, at, _ in layout(data) if opcode == Opcode.DATA_END)
    body = struct.pack("<HIQQ", 999, 0, S, S) + b"x"
    path.write_bytes(data[:end] + HEAD.pack(Opcode.MESSAGE, len(body)) + body + data[end:])
    return path


def parquet(spoil: Callable[[Path], object]) -> Callable[[Path], Path]:
    def build(folder: Path) -> Path:
        path = folder / "log.parquet"
        with ParquetWriter(path, LogInfo("log", "id"), c.rig(), rows_per_group=2) as writer:
            for item in sorted(items(), key=lambda m: m.log_ns):
                writer.write(item)
        spoil(path)
        return path

    return build


def flip_middle(path: Path) -> None:
    file = next(path.glob("*lidar*.parquet"))
    data = bytearray(file.read_bytes())
    data[len(data) // 4] ^= 1
    file.write_bytes(data)


def cut_footer(path: Path) -> None:
    file = next(path.glob("*lidar*.parquet"))
    file.write_bytes(file.read_bytes()[:-20])


def escaping(path: Path) -> None:
    log = json.loads((path / "log.json").read_text())
    log.pop("digest")
    log["streams"][0]["file"] = "../secret.parquet"
    (path / "log.json").write_text(json.dumps(log))


def recalibrated(folder: Path) -> Path:
    moved = c.rig()
    mounts = {**moved.mounts, "lidar": replace(moved.mounts["lidar"], translation_m=np.array([0.0, 0, 0.1]))}
    with McapWriter(folder / "log.mcap", LogInfo("log", "id"), c.rig()) as writer:
        for i, item in enumerate(sorted(items(), key=lambda m: m.log_ns)):
            if i == 12:
                writer.write_rig(item.log_ns, replace(moved, mounts=mounts))
            writer.write(item)
    return folder / "log.mcap"


def shifted(num: int, stamp_ns: int, log_ns: int) -> Callable[[Path], Path]:
    """Stamps and log times of all but the first (negative: of the first) `num` frames move."""

    def change(messages: list[Any]) -> list[Any]:
        border = S + 100 * c.MS * abs(num)
        return [
            replace(m, stamp_ns=m.stamp_ns + stamp_ns, log_ns=m.log_ns + log_ns)
            if (m.stamp_ns < border) == (num < 0)
            else m
            for m in messages
        ]

    return changed(change)


def split_with_a_missing_file(folder: Path) -> Path:
    out = folder / "bag"
    out.mkdir()
    c.write_log(out / "bag_0.mcap", items())
    names = "".join(f"\n    - {name}" for name in ("bag_0.mcap", "bag_1.mcap"))
    (out / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 8\n  storage_identifier: mcap\n  relative_file_paths:{names}\n"
    )
    return out


def no_lidar(messages: list[Any]) -> list[Any]:
    return [m for m in messages if not isinstance(m, PointCloud)]


def without_lidar(folder: Path) -> Path:
    rig = replace(c.rig(), mounts={n: m for n, m in c.rig().mounts.items() if n != "lidar"})
    return c.write_log(folder / "log.mcap", no_lidar(items()), rig)


def truth_twice(messages: list[Any]) -> list[Any]:
    box = Boxes3D(
        np.zeros((2, 3)) + 9, np.ones((2, 3)), np.zeros(2), label=np.array(["car"] * 2), track_id=np.ones(2, int)
    )
    return [replace(m, boxes3d=box) if isinstance(m, Truth) else m for m in messages]


def truth_crowded(messages: list[Any]) -> list[Any]:
    num = MAX_BOXES + 1
    boxes = Boxes3D(np.full((num, 3), 9.0), np.ones((num, 3)), np.zeros(num), track_id=np.arange(num))
    return [replace(m, boxes3d=boxes) if isinstance(m, Truth) and m.stamp_ns == S else m for m in messages]


def truth_flat(messages: list[Any]) -> list[Any]:
    box = Boxes3D(np.zeros((1, 3)) + 9, np.array([[4.0, 0, 1]]), np.zeros(1), label=np.array(["car"]))
    return [replace(m, boxes3d=box) if isinstance(m, Truth) and m.stamp_ns == S else m for m in messages]


def text(folder: Path) -> Path:
    (folder / "a.mcap").write_text("stamp,x\n1,2\n")
    return folder / "a.mcap"


def empty_file(folder: Path) -> Path:
    (folder / "a.mcap").touch()
    return folder / "a.mcap"


def empty_folder(folder: Path) -> Path:
    (folder / "a").mkdir()
    return folder / "a"


CASES = [
    Case("text", "LOG001", text, 3),
    Case("an empty file", "LOG001", empty_file, 3),
    Case("an empty folder", "LOG001", empty_folder, 3),
    Case("cut off", "LOG002", edited(cut), 4, also=("GT006",)),
    Case("no summary", "LOG003", edited(same, **NO_SUMMARY), 0),
    Case("flipped bit", "LOG004", edited(chunk_flipped), 4),
    Case("flipped bit, no summary", "LOG004", edited(chunk_flipped, **NO_SUMMARY), 4, also=("LOG003",)),
    Case("checksum of all", "LOG005", edited(end_changed, **NO_SUMMARY), 0, also=("LOG003",)),
    Case("no checksums", "LOG006", edited(same, enable_crcs=False), 0, count=0, also=("LOG003",)),
    Case("unknown compression", "LOG007", one_chunk("br", 10, b"0123456789"), 3),
    Case("unknown channel", "LOG008", unknown_channel, 4, also=("LOG003", "LOG006")),
    Case("two types", "LOG009", foreign(("/lidar/points", "foxglove.RawImage", "protobuf", [b""])), 3),
    Case("not UTF-8", "LOG010", edited(lambda d: d.replace(b"/radar/points", b"/radar/point\xff"), enable_crcs=False,
         enable_data_crcs=False), 4, also=("LOG003", "LOG006")),
    Case("missing file", "LOG011", split_with_a_missing_file, 4),
    Case("unused topic", "LOG012", foreign(("/imu", "sensor_msgs/msg/Imu", "cdr", [b"x", b"y"])), 0),
    Case("unread sensor", "LOG013", foreign(("/pandar_packets", "acme_msgs/msg/Packets", "cdr", [b"x", b"y"])), 0),
    Case("huge record", "LIM001", huge_record, 3),
    Case("chunk that declares too much", "LIM001", one_chunk("zstd", 2**40, b"x"), 3),
    Case("zstd bomb", "LIM002", one_chunk("zstd", 100, zstandard.compress(bytes(100_000_000))), 3),
    Case("lz4 bomb", "LIM002", one_chunk("lz4", 100, lz4.frame.compress(bytes(100_000_000))), 3),
    Case("damaged payload", "DEC001", foreign(("/more/points", "foxglove.PointCloud", "protobuf", [b"\xff"])), 4),
    Case("image of another size", "LIM003", changed(lambda ms: [
        replace(m, size_wh=(40, 30)) if isinstance(m, Image) and m.stamp_ns == S else m for m in ms]), 4),
    Case("mostly NaN", "DAT001", on_third_cloud(lambda m: replace(m, xyz=np.full((9, 3), np.nan, np.float32))), 4),
    Case("empty cloud", "DAT002", on_third_cloud(lambda m: replace(m, xyz=np.zeros((0, 3), np.float32))), 0),
    Case("far points", "DAT003", on_third_cloud(lambda m: replace(m, xyz=np.append(m.xyz, [[9e3, 0, 0]], 0)
         .astype(np.float32))), 0),
    Case("some NaN", "DAT004", on_third_cloud(lambda m: replace(m, xyz=np.append(m.xyz, [[np.nan, 0, 0]], 0)
         .astype(np.float32))), 0),
    Case("pose that is none", "DAT005", changed(lambda ms: [
        *ms, Pose("gnss", S, S, np.array([0, np.nan, 0]), np.array([0, 0, 0, 1.0]))]), 4),
    Case("infinite Doppler", "DAT006", changed(lambda ms: [
        replace(m, radial_velocity_mps=np.full(4, np.inf, np.float32)) if isinstance(m, RadarScan) and m.stamp_ns == S
        else m for m in ms]), 0),
    Case("no transform", "CAL001", lambda f: c.write_log(f / "log.mcap", items(), replace(
        c.rig(), mounts={n: m for n, m in c.rig().mounts.items() if n != "radar"})), 3),
    Case("recalibrated", "CAL002", recalibrated, 0),
    Case("no LiDAR", "CFG001", without_lidar, 3),
    Case("no such topic", "CFG001", changed(list), 2, args=("-p", "lidar3d", "--topics", "/lidr")),
    Case("out of order", "TIM001", on_third_cloud(
        lambda m: replace(m, stamp_ns=m.stamp_ns - 150 * c.MS)), 0, also=("GT006",)),
    Case("jump back", "TIM005", shifted(-3, 60 * S, 0), 0, also=("GT006",)),
    Case("gap", "TIM007", shifted(3, 60 * S, 60 * S), 0),
    Case("boot time", "TIM008", changed(lambda ms: [
        replace(m, stamp_ns=m.stamp_ns + 10**18, log_ns=m.log_ns + 10**18) if not isinstance(m, PointCloud)
        else replace(m, log_ns=m.log_ns + 10**18) for m in ms]), 3),
    Case("one id twice", "GT003", changed(truth_twice), 3),
    Case("truth without size", "GT004", changed(truth_flat), 4),
    Case("crowded truth", "GT008", changed(truth_crowded), 4),
    Case("stray truth", "GT006", changed(lambda ms: [*ms, Truth(9 * S, 9 * S, Boxes3D(
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)))]), 0),
    Case("cut footer", "PQ001", parquet(cut_footer), 3),
    Case("flipped bit in Parquet", "PQ002", parquet(flip_middle), 4, also=("GT006",)),
    Case("path out of the log", "SEC002", parquet(escaping), 3),
]  # fmt: skip

ELSEWHERE = {
    "COR001": "tests/replay/conditions/test_disturb.py::"
    "test_conditions_that_break_their_promise_end_the_replay_in_one_line",
    "COR002": "tests/replay/conditions/test_disturb.py::test_what_a_log_lacks_is_an_error",
    "CFG003": "tests/replay/formats/test_rig_files.py::test_bad_files_are_refused_in_one_line",
    "DEC002": "tests/cli/test_replay_bad_input.py::test_corrupt_image_is_a_fault_of_its_frame",
    "DEC003": "tests/replay/logs/test_foreign.py::test_broken_clouds_are_counted",
    "DEC004": "tests/cli/test_video.py::test_lost_messages_are_faults_and_no_picture_is_wrong",
    "DEC005": "tests/cli/test_video.py::test_a_recording_that_begins_between_keyframes_is_complete",
    "DEC006": "tests/replay/logs/codecs/video/test_damage.py::test_videos_whose_losses_go_unseen_are_flagged",
    "FRM001": "tests/replay/engine/test_absence.py::test_what_came_is_never_said_to_have_never_come",
    "GT001": "tests/cli/test_score_files.py::test_truth_for_no_sequence_is_an_error",
    "GT005": "tests/replay/formats/test_openlabel.py::test_what_is_no_box_is_counted",
    "GT007": "tests/replay/logs/test_ros_rig.py::test_classes_that_mean_nothing_are_counted_once",
    "LIM005": "tests/metrics/core/test_similarity.py::test_more_pairs_than_fit_into_memory_are_refused",
    "LIM004": "tests/replay/logs/containers/parquet/test_limits.py::test_a_page_that_claims_gigabytes_is_refused",
    "TIM011": "tests/replay/logs/test_foreign.py::test_headers_without_stamps_are_told",
    "TIM013": "tests/replay/logs/test_foreign.py::test_times_that_arent_understood_are_told_once",
    "PRD001": "tests/replay/engine/test_run.py::test_non_finite_boxes_and_reported_faults_are_counted",
    "PRD002": "tests/replay/engine/test_run.py::test_failing_frame_is_counted_and_the_rest_goes_on",
    "PRD003": "tests/pipelines/variants/test_recorded.py::test_results_that_no_frame_takes_are_counted",
    "PRD005": "tests/pipelines/variants/test_lidar3d.py::test_a_judge_that_rejects_nearly_all_cars_is_flagged",
    "PRD006": "tests/pipelines/variants/test_images2d.py::"
    "test_a_sparse_radar_sees_the_car_and_that_it_approaches_the_own_one",
    "PRD007": "tests/pipelines/sensors/bev/test_bev.py::test_the_built_in_network_says_that_it_knows_the_city_alone",
    "PRD004": "tests/pipelines/variants/test_recorded.py::test_results_before_their_frame_have_no_latency",
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_row(fbench, tmp_path, case):
    log = case.build(tmp_path)
    result = fbench("replay", log, *case.args, "-o", "run")
    assert result.code == case.exit, result.err
    fatal = case.exit in (2, 3)
    assert fatal == (FAULTS[case.code].behaviour == "fatal")
    if fatal:
        assert result.err.startswith("fbench: ")
        assert result.err.endswith(f"[{case.code}]\n")
        assert result.err.count("\n") == 1
        assert not (tmp_path / "run").exists()
        return
    rows = json.loads((tmp_path / "run" / "faults.json").read_text())["rows"]
    met = {row["code"]: row["count"] for row in rows if row["count"]}
    assert met.pop(case.code) >= case.count
    assert set(met) <= set(case.also)
    complete = json.loads((tmp_path / "run" / "manifest.json").read_text())["complete"]
    assert complete == (case.exit == 0)


def test_every_row_of_the_table_has_a_test():
    assert sorted({case.code for case in CASES} | set(ELSEWHERE)) == sorted(FAULTS)
    for place in ELSEWHERE.values():
        file, _, name = place.partition("::")
        assert f"def {name}(" in (ROOT / file).read_text()


def test_budget_decides_what_is_complete(fbench, tmp_path):
    log = edited(chunk_flipped)(tmp_path)
    args = ("replay", log, "-p", "lidar3d", "--overwrite", "-o", "run")
    assert fbench(*args).code == 4
    assert fbench(*args, "--fault-budget", "LOG004=1").code == 0
    assert fbench(*args, "--fault-budget", "1").code == 0
    assert fbench(*args, "--fault-budget", "DEC001=9").code == 4
    assert fbench(*args, "--on-fault", "tolerant").code == 0
    assert fbench(*args, "--on-fault", "tolerant", "--fault-budget", "LOG004=0").code == 4
    bad = fbench(*args, "--fault-budget", "LOG04=1")
    assert bad.code == 2
    assert "did you mean 'LOG004'" in bad.err
