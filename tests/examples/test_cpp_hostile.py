"""The C++ header reads damaged requests without harm, under the sanitizers for memory and undefined behaviour."""

import shutil
import struct
import subprocess

import numpy as np
import pytest
from tests.examples.conftest import EXAMPLES

from fbench.pipelines.external import fbench_exec_pb2 as schema
from fbench.pipelines.external.messages import frame_request, hello, small_request
from fbench.replay.data.frames import Frame
from fbench.replay.data.messages import Image, Message, PointCloud, Pose, RadarScan
from fbench.replay.data.rig import CameraModel, LogInfo, Mount, Rig

NUM = 3000


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    if not shutil.which("g++"):
        pytest.skip("no g++ here")
    program = tmp_path_factory.mktemp("sanitized") / "echo"
    flags = ["-std=c++17", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    command = ["g++", *flags, str(EXAMPLES / "cpp" / "echo.cpp"), "-o", str(program)]
    result = subprocess.run(command, capture_output=True, text=True)
    if "cannot find" in result.stderr:
        pytest.skip("g++ has no sanitizers here")
    assert result.returncode == 0, result.stderr
    return program


def requests() -> list[bytes]:
    one, xyz = np.ones(20, np.float32), np.ones((20, 3), np.float32)
    messages: list[Message] = [
        PointCloud("lidar", 1, 2, xyz, one, one.astype("u2"), one.astype("i4")),
        RadarScan("radar", 1, 2, xyz, one),
        Image("cam", 1, 2, b"abc", "jpeg", (3, 4)),
        Pose("pose", 1, 2, np.ones(3), np.ones(4)),
    ]
    camera = CameraModel(np.eye(3), (3, 4), "plumb_bob", np.ones(5))
    rig = Rig({"cam": Mount("camera", np.zeros(3), np.ones(4))}, {"cam": camera})
    return [
        b"".join(frame_request(1, Frame(0, 1, 0, {m.sensor: m for m in messages}, {"gone": "late"}))),
        bytes(small_request(2, hello(rig, LogInfo("drive", "drive-1", {"place": "here"})))[0]),
        bytes(small_request(3, reset=schema.Reset(reason="gap"))[0]),
    ]


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.integers(0, 5)):
        at = int(rng.integers(0, len(changed) + 1))
        match rng.integers(0, 4):
            case 0:
                del changed[at:]
            case 1:
                changed[at:at] = rng.bytes(3)
            case _:
                changed[at : at + 1] = rng.bytes(1)
    return bytes(changed)


@pytest.mark.slow
def test_damaged_requests_are_answered(sanitized):
    rng = np.random.Generator(np.random.Philox(key=3))
    whole = requests()
    sent = [damaged(whole[int(rng.integers(0, len(whole)))], rng) for _ in range(NUM)]
    stream = b"".join(struct.pack("<I", len(data)) + data for data in sent)
    result = subprocess.run([str(sanitized), "--checksum"], input=stream, capture_output=True)
    assert result.returncode == 0, result.stderr[-2000:]
    answers, rest = 0, result.stdout
    while rest:
        (num,) = struct.unpack_from("<I", rest)
        rest, answers = rest[4 + num :], answers + 1
    assert answers == NUM


def test_request_that_is_too_long_or_ends_ends_the_program(sanitized):
    for stream, line in (
        (b"\xff\xff\xff\xff", b"request is too long"),
        (b"\x10\x00\x00\x00abc", b"stdin ends within a request"),
    ):
        result = subprocess.run([str(sanitized)], input=stream, capture_output=True)
        assert (result.returncode, result.stdout) == (1, b"")
        assert line in result.stderr
