"""Arbitrary bytes in every place: typed errors and counted faults only."""

import tempfile
from contextlib import suppress
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from google.protobuf.timestamp_pb2 import Timestamp
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer
from tests.replay.logs import builders as b

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import Truth
from fbench.replay.logs.codecs.foxglove.topics import message_records
from fbench.replay.logs.containers.mcap.records import MAGIC

KINDS = ["calibration", "camera", "lidar", "pose", "radar", "transform", "truth"]
SCHEMAS = [
    "foxglove.CameraCalibration", "foxglove.CompressedImage", "foxglove.FrameTransform", "foxglove.FrameTransforms",
    "foxglove.PointCloud", "foxglove.PoseInFrame", "foxglove.RawImage", "foxglove.SceneUpdate",
]  # fmt: skip
quick = settings(max_examples=150, deadline=None)


def used(path):
    """Use all of a log; whatever is wrong must come as an FbenchError or a fault."""
    with suppress(FbenchError):
        reader, _ = b.read(path)
        list(reader.messages())
        list(reader.truths())
        _ = reader.info
        _ = reader.rig


@quick
@given(st.binary(max_size=200), st.booleans())
def test_bytes_after_the_magic(data, ended):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        path.write_bytes(MAGIC + data + (MAGIC if ended else b""))
        used(path)


def one_channel(folder, schema, metadata, messages):
    path = folder / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/a", "protobuf", writer.register_schema(schema, "protobuf", b""), metadata)
        for log_ns, data in messages:
            writer.add_message(channel, log_ns, data, log_ns)
        writer.finish()
    return path


def payload(item):
    return next(iter(message_records(item))).proto.SerializeToString()


payloads = st.binary(max_size=60) | st.one_of(b.images, b.clouds, b.scans, b.poses, b.truths).map(payload)


@pytest.mark.slow
@quick
@given(
    st.sampled_from(SCHEMAS),
    st.none() | st.fixed_dictionaries(
        {"kind": st.sampled_from(KINDS), "sensor": b.texts},
        optional={"size_wh": st.sampled_from(["", "x", "3x", "-1x2", "²x1", "4x3"])},
    ),
    st.lists(st.tuples(st.integers(0, 2**64 - 1), payloads), max_size=4),
)  # fmt: skip
def test_bytes_as_payload(schema, metadata, messages):
    with tempfile.TemporaryDirectory() as folder:
        used(one_channel(Path(folder), schema, metadata or {}, messages))


@pytest.mark.parametrize("stamp", [Timestamp(seconds=-1), Timestamp(seconds=2**62), Timestamp(nanos=-5)])
def test_stamp_out_of_range_is_counted(tmp_path, stamp):
    path = one_channel(tmp_path, "foxglove.PoseInFrame", {}, [(1, PoseInFrame(timestamp=stamp).SerializeToString())])
    reader, faults = b.read(path)
    assert list(reader.messages()) == []
    assert "is out of range" in faults.places["DEC001"][0]


def test_truth_after_a_clock_that_jumped_back_stays_behind(tmp_path):
    stamps = [*range(1000, 1600), *range(600)]
    items = [Truth(stamp, 5000 + i, Boxes3D.empty()) for i, stamp in enumerate(stamps)]
    reader, _ = b.read(b.write(tmp_path / "log.mcap", items))
    found = [t.stamp_ns for t in reader.truths()]
    assert sorted(found) == sorted(stamps)
    assert found[:300] == stamps[:300]
