"""MCAP files of JSON messages with Foxglove's schemas, as its SDKs and web tools write them."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
from google.protobuf.json_format import MessageToDict
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.video.builders import encode, write_log

from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan, Truth

JPEG = encode_jpeg(np.zeros((6, 8, 3), np.uint8))
TIME = {"sec": 1_700_000_000, "nsec": 123_456_789}
TIME_NS = 1_700_000_000_123_456_789
UNMOVED = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
FLOAT32, UINT16 = 7, 3  # foxglove.PackedElementField.type


def text(data: bytes) -> str:
    return base64.b64encode(data).decode()


def log(tmp_path, *items, metadata=(), encoding="json"):
    """Write (topic, schema, message) triples one nanosecond apart; a message is bytes, or an object."""
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for i, (topic, schema, message) in enumerate(items):
            schema_id = writer.register_schema(f"foxglove.{schema}", "jsonschema", b'{"type": "object"}')
            channel = writer.register_channel(topic, encoding, schema_id, metadata[i] if metadata else {})
            data = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, i, data, i)
        writer.finish()
    return b.read(path)


def cloud(rows, names="xyz", frame="lidar", **changes):
    data = np.array(rows, "<f4").reshape(-1, len(names))
    fields = [{"name": name, "offset": 4 * i, "type": FLOAT32} for i, name in enumerate(names)]
    parts = {"timestamp": TIME, "frame_id": frame, "pose": UNMOVED, "point_stride": 4 * len(names), "fields": fields}
    return {**parts, "data": text(data.tobytes()), **changes}


def edge(child, x):
    return {
        "timestamp": TIME, "parent_frame_id": "base_link", "child_frame_id": child,
        "translation": {"x": x, "y": 0, "z": 1}, "rotation": {"x": 0, "y": 0, "z": 0, "w": 1},
    }  # fmt: skip


CALIBRATION = {
    "timestamp": TIME, "frame_id": "cam", "width": 8, "height": 6, "distortion_model": "plumb_bob",
    "D": [0.1, 0.2, 0, 0], "K": [500, 0, 4, 0, 500, 3, 0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, 1], "P": [0] * 12,
}  # fmt: skip
CUBE = {"pose": {**UNMOVED, "position": {"x": 9, "y": 2, "z": 1}}, "size": {"x": 4, "y": 2, "z": 1.5}, "color": {}}
ENTITY = {
    "timestamp": TIME, "frame_id": "base_link", "id": "7", "lifetime": {"sec": 0, "nsec": 100}, "cubes": [CUBE],
    "metadata": [{"key": "class", "value": "truck"}, {"key": "score", "value": "0.5"}],
}  # fmt: skip


def test_every_schema_becomes_what_it_is(tmp_path):
    reader, faults = log(
        tmp_path,
        ("/tf", "FrameTransforms", {"transforms": [edge("lidar", 1.5), edge("front", 3.5)]}),
        ("/tf2", "FrameTransform", edge("cam", 2)),
        ("/cam/calibration", "CameraCalibration", CALIBRATION),
        ("/points", "PointCloud", cloud([(1, 2, 3), (4, 5, 6)])),
        ("/radar", "PointCloud", cloud([(1, 2, 3, -4)], ["x", "y", "z", "velocity"], "front")),
        ("/cam/image", "CompressedImage", {"timestamp": TIME, "frame_id": "cam", "format": "jpg", "data": text(JPEG)}),
        ("/pose", "PoseInFrame", {"timestamp": TIME, "frame_id": "map", "pose": CUBE["pose"]}),
        ("/labels", "SceneUpdate", {"deletions": [], "entities": [ENTITY]}),
    )
    assert {name: mount.translation_m.tolist() for name, mount in reader.rig.mounts.items()} == {
        "cam": [2, 0, 1], "front": [3.5, 0, 1], "lidar": [1.5, 0, 1],
    }  # fmt: skip
    camera = reader.rig.cameras["cam"]
    assert (camera.K[0, 0], camera.K[1, 2], camera.size_wh, camera.distortion[1]) == (500, 3, (8, 6), 0.2)
    sweep, scan, image, pose = reader.messages()
    assert [type(m) for m in (sweep, scan, image, pose)] == [PointCloud, RadarScan, Image, Pose]
    assert {message.stamp_ns for message in (sweep, scan, image, pose)} == {TIME_NS}
    assert sweep.xyz.tolist() == [[1, 2, 3], [4, 5, 6]]
    assert scan.radial_velocity_mps.tolist() == [-4]
    assert (image.data, image.encoding, image.size_wh) == (JPEG, "jpeg", (8, 6))
    assert pose.translation_m.tolist() == [9, 2, 1]
    [truth] = reader.truths()
    assert (truth.stamp_ns, truth.boxes3d.label.tolist(), truth.boxes3d.score.tolist()) == (TIME_NS, ["truck"], [0.5])
    assert truth.boxes3d.center_m.tolist() == [[9, 2, 1]]
    assert not faults.counts


@pytest.mark.parametrize("absent", [None, float("inf"), float("nan")])
def test_planar_scans_whose_rays_without_return_json_cant_spell(tmp_path, absent):
    scan = {
        "timestamp": TIME, "frame_id": "front", "pose": UNMOVED, "start_angle": 0, "end_angle": np.pi,
        "ranges": [2, absent, 3], "intensities": [0.5, 0, 0.25],
    }  # fmt: skip
    reader, faults = log(tmp_path, ("/tf", "FrameTransform", edge("front", 1)), ("/scan", "LaserScan", scan))
    [sweep] = reader.messages()
    assert (sweep.sensor, sweep.stamp_ns) == ("front", TIME_NS)
    np.testing.assert_allclose(sweep.xyz, [[2, 0, 0], [-3, 0, 0]], atol=1e-6)
    assert sweep.intensity.tolist() == [0.5, 0.25]
    assert not faults.counts


def test_videos_have_the_same_pictures_as_in_protobuf(tmp_path):
    packets = encode(num=8, key_every=4)
    (tmp_path / "proto").mkdir()
    messages = b.read(write_log(tmp_path / "proto" / "log.mcap", packets))[0].messages()
    expected = [m for m in messages if isinstance(m, Image)]
    videos = [{"timestamp": TIME, "frame_id": "cam", "format": "h264", "data": text(packet)} for packet in packets]
    reader, faults = log(
        tmp_path, ("/tf", "FrameTransform", edge("cam", 2)), ("/calibration", "CameraCalibration", CALIBRATION),
        *(("/video", "CompressedVideo", video) for video in videos),
    )  # fmt: skip
    found = list(reader.messages())
    assert [m.encoding for m in found] == ["h264"] * 8
    assert [m.size_wh for m in found] == [m.size_wh for m in expected]
    assert [m.video.index for m in found] == [m.video.index for m in expected] == [0, 1, 2, 3] * 2
    assert not faults.counts


def test_raw_images_with_padding(tmp_path):
    message = {"frame_id": "cam", "width": 1, "height": 2, "encoding": "bgr8", "step": 4, "data": text(bytes(range(8)))}
    reader, _ = log(tmp_path, ("/image", "RawImage", message))
    [image] = reader.messages()
    assert (image.encoding, image.size_wh, image.data) == ("bgr8", (1, 2), bytes([0, 1, 2, 4, 5, 6]))
    assert image.stamp_ns == 0


def in_json(proto):
    """The message as Foxglove's JSON schemas have it: times as objects."""

    def convert(value):
        if isinstance(value, dict):
            return {key: times(key, convert(part)) for key, part in value.items()}
        return [convert(part) for part in value] if isinstance(value, list) else value

    def times(key, value):
        if key != "timestamp":
            return value
        stamp = np.datetime64(value.removesuffix("Z"), "ns").astype(np.int64)
        return {"sec": int(stamp) // 10**9, "nsec": int(stamp) % 10**9}

    plain = MessageToDict(proto, preserving_proto_field_name=True, use_integers_for_enums=True)
    return convert(plain)


def test_a_log_of_fbench_says_the_same_in_json(tmp_path):
    b.write(tmp_path / "own.mcap", b.sequence(10), b.the_rig())
    items, metadata = [], []
    with (tmp_path / "own.mcap").open("rb") as file:
        for schema, channel, _, proto in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            items.append((channel.topic, schema.name.removeprefix("foxglove."), in_json(proto)))
            metadata.append(channel.metadata)
    reader, faults = log(tmp_path, *items, metadata=metadata)
    original, _ = b.read(tmp_path / "own.mcap")
    mine, theirs = (
        sorted([*r.messages(), *r.truths()], key=lambda m: (type(m).__name__, m.log_ns)) for r in (reader, original)
    )
    assert len(mine) == len(theirs) == 50
    for one, other in zip(mine, theirs, strict=True):
        same = {"log_ns": other.log_ns, "frame_number": other.frame_number}
        if isinstance(one, Truth):
            same["stamp_ns"] = other.stamp_ns  # which fbench stores outside of the message
        assert b.canonical(replace(one, **same)) == b.canonical(other)
    assert not faults.num_lost


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"{", "not JSON (Expecting property name"),
        (b"\xff\xfe{}", "not JSON ("),
        (b"[" * 100_000, "JSON is nested too deeply"),
        (b"[" + b"0," * 500_001 + b"0]", "JSON of over 500002 values, more than 500000"),
        (b'{"point_stride": ' + b"1" * 5000 + b"}", "not JSON (Exceeds the limit"),
        ([1, 2], "not a foxglove.PointCloud (a JSON list, expected an object)"),
        (cloud([(1, 2, 3)], data="####"), "its data aren't base64"),
        (cloud([(1, 2, 3)], data=[1, 2, 3]), "its data are a JSON list, expected a text in base64"),
        (cloud([(1, 2, 3)], point_stride=-1), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], point_stride=1e300), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], point_stride="many"), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], fields={"name": "x"}), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], fields=[3]), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], fields=[{"name": "x", "type": 70}]), "points have no field y, z"),
        (cloud([(1, 2, 3)], frame_id="\ud800"), "not JSON ('utf-8' codec can't encode"),
        ({**cloud([(1, 2, 3)]), "\udc00": 1}, "not JSON ('utf-8' codec can't encode"),
        (cloud([(1, 2, 3)], frame_id={"a": 1}), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], timestamp={"sec": -5, "nsec": 0}), "stamp of -5 s 0 ns is out of range"),
        (cloud([(1, 2, 3)], timestamp={"sec": 10**18, "nsec": 0}), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], timestamp={"sec": 1.5, "nsec": 0}), "a time of 1.5 s 0 ns isn't of whole numbers"),
        (cloud([(1, 2, 3)], timestamp={"sec": "1", "nsec": 0}), "a time of '1' s 0 ns isn't of whole numbers"),
        (cloud([(1, 2, 3)], timestamp=[1]), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], pose={"position": {"x": float("nan")}}), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], pose={"position": {"x": 10**400}}), "not a foxglove.PointCloud ("),
        (cloud([(1, 2, 3)], pose={"position": {"x": "NaN"}}), "pose of the points isn't one"),
    ],
)
def test_what_is_wrong_with_one_message_is_told_in_one_line(tmp_path, message, reason):
    reader, faults = log(tmp_path, ("/points", "PointCloud", cloud([(1, 2, 3)])), ("/points", "PointCloud", message))
    assert len(list(reader.messages())) == 1
    place = (faults.places.get("DEC001") or faults.places["DEC003"])[0]
    assert faults.num_lost == 1
    assert place.startswith("log.mcap: /points at 1: ")
    assert reason in place
    assert len(place) < 1500
    assert place.isprintable()


def test_boxes_that_are_no_boxes(tmp_path):
    broken = {**ENTITY, "cubes": [{**CUBE, "size": {"x": "Infinity", "y": 1, "z": 1}}]}
    reader, faults = log(tmp_path, ("/labels", "SceneUpdate", {"entities": [broken]}))
    assert list(reader.truths()) == []
    assert faults.places["DEC001"] == ["log.mcap: /labels at 0: box 0 isn't finite"]


@pytest.mark.parametrize("encoding", ["flatbuffer", "msgpack", "cbor"])
def test_encodings_that_nothing_reads_are_named_with_what_helps(tmp_path, encoding):
    reader, faults = log(tmp_path, ("/points", "PointCloud", b"\0\1"), encoding=encoding)
    assert list(reader.messages()) == []
    assert faults.places["LOG013"] == [
        (
            f"log.mcap: topic '/points' has type 'foxglove.PointCloud' (encoding {encoding}), "
            "an encoding that only a decoder plug-in can read; name one with --decoder"
        )
    ]
