"""Decoders of outsiders: which messages they get, what becomes of what they return, and of what they raise."""

import json
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from tests.replay.logs.codecs.video.builders import SIZE, encode

from fbench.replay.contracts.decoders import BoxesIn, Decoder, decodes
from fbench.replay.contracts.errors import ConfigError, TerminatedError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.testing import check_decoder
from fbench.replay.data.boxes import Boxes2D, Boxes3D
from fbench.replay.data.images import encode_jpeg
from fbench.replay.data.messages import Image, PointCloud, Pose, RadarScan, Truth
from fbench.replay.logs.codecs.plugin import NamedDecoder
from fbench.replay.logs.open import open_log
from fbench.replay.logs.setup import Setup

JPEG = encode_jpeg(np.zeros((6, 8, 3), np.uint8))
TF = {
    "transforms": [
        {"parent_frame_id": "base_link", "child_frame_id": "dev", "translation": {"x": 2, "y": 0, "z": 1},
         "rotation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    ]
}  # fmt: skip


def write(path, payloads, topic="/dev/data", schema="acme.Data", encoding="acme", tf=True):
    """Messages of a vendor, from 1000 ns on, each published 1 ns before, and a transform of the device `dev`."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        if tf:
            schema_id = writer.register_schema("foxglove.FrameTransforms", "jsonschema", b"{}")
            channel = writer.register_channel("/tf_static", "json", schema_id)
            writer.add_message(channel, 500, json.dumps(TF).encode(), 500)
        schema_id = writer.register_schema(schema, "acme-idl", b"how to read it") if schema else 0
        channel = writer.register_channel(topic, encoding, schema_id, {"unit": "m"})
        for i, data in enumerate(payloads):
            writer.add_message(channel, 1000 + i, data, 999 + i)
        writer.finish()
    return path


def opened(tmp_path, decoder, payloads=(b"\1",), *, is_required=True, **how):
    faults = FaultLog()
    setup = Setup(decoders=(NamedDecoder("acme.py:read", decoder, is_required),))
    return open_log(write(tmp_path / "log.mcap", payloads, **how), faults, (), setup), faults


def cloud(payload, **changes):
    xyz = np.frombuffer(payload.data, np.uint8).astype(np.float32)[:, None] * np.ones(3, np.float32)
    return PointCloud(**{"sensor": "dev", "stamp_ns": payload.log_ns * 10**9, "log_ns": 0, "xyz": xyz, **changes})


def test_a_decoder_gets_all_that_the_log_says(tmp_path):
    got = []

    def read(payload):
        got.append(payload)
        return cloud(payload)

    reader, faults = opened(tmp_path, decodes("acme.Data", kind="lidar")(read), [b"\1", b"\2\3"])
    assert reader.rig.mounts["dev"].translation_m.tolist() == [2, 0, 1]
    got.clear()
    first, second = reader.messages()
    assert (first.sensor, first.stamp_ns, first.log_ns) == ("dev", 1000 * 10**9, 1000)
    assert second.xyz.tolist() == [[2, 2, 2], [3, 3, 3]]
    payload = got[-1]
    assert (payload.data, payload.topic, payload.log_ns, payload.publish_ns) == (b"\2\3", "/dev/data", 1001, 1000)
    assert (payload.encoding, payload.schema_name, payload.schema_encoding) == ("acme", "acme.Data", "acme-idl")
    assert (payload.schema_data, payload.metadata) == (b"how to read it", {"unit": "m"})
    assert not faults.counts


RESULTS: dict[str, Any] = {
    "camera": Image("dev", 7, 0, JPEG, "jpeg", (0, 0)), "lidar": PointCloud("dev", 7, 0, np.ones((2, 3), np.float32)),
    "radar": RadarScan("dev", 7, 0, np.ones((2, 3), np.float32), np.ones(2, np.float32)),
    "pose": Pose("", 7, 0, np.array([1.0, 2, 3]), np.array([0, 0, 0, 1.0])),
}  # fmt: skip


@pytest.mark.parametrize("kind", RESULTS)
def test_every_kind_of_message(tmp_path, kind):
    reader, faults = opened(tmp_path, decodes("acme.Data", kind=kind)(lambda payload: RESULTS[kind]))
    [message] = reader.messages()
    assert type(message) is type(RESULTS[kind])
    assert (message.stamp_ns, message.log_ns) == (7, 1000)
    if isinstance(message, Image):
        assert message.size_wh == (8, 6)  # as the JPEG says
    if isinstance(message, Pose):
        assert message.translation_m.tolist() == [1, 2, 3]
        assert reader.poses == ("dev/data",)
    assert not faults.counts


BOXES = Boxes3D(np.array([[5.0, 0, 0]]), np.array([[4.0, 2, 1.5]]), np.zeros(1), label=np.array(["Lorry"]))


@pytest.mark.parametrize(
    ("found", "center"),
    [(Truth(7, 0, BOXES), [5, 0, 0]), (BoxesIn(Truth(7, 0, BOXES), "dev"), [7, 0, 1])],
)
def test_boxes_come_into_body_coordinates_with_labels_of_fbench(tmp_path, found, center):
    decoder = decodes("acme.Data", kind="boxes")(lambda payload: found)
    reader, faults = opened(tmp_path, decoder, topic="/labels/objects")
    [truth] = reader.truths()
    assert (truth.stamp_ns, truth.log_ns, truth.boxes3d.center_m.tolist()) == (7, 1000, [center])
    assert (truth.boxes3d.label.tolist(), truth.boxes3d.source_label.tolist()) == (["truck"], ["Lorry"])
    assert not faults.counts


def test_boxes_of_a_topic_that_is_not_called_truth_are_results(tmp_path):
    reader, _ = opened(tmp_path, decodes("acme.Data", kind="boxes")(lambda payload: Truth(7, 0, BOXES)))
    assert list(reader.truths()) == []
    [result] = reader.detections("/dev/data")
    assert result.boxes3d.center_m.tolist() == [[5, 0, 0]]


def test_boxes_in_the_world_need_poses(tmp_path):
    decoder = decodes("acme.Data", kind="boxes")(lambda payload: Truth(7, 0, BOXES, in_world=True))
    reader, faults = opened(tmp_path, decoder, topic="/labels/objects")
    assert list(reader.truths()) == []
    assert "boxes in 'world', which no fixed transform links to 'base_link'" in faults.places["DEC001"][0]


def test_2d_boxes_are_of_the_camera_with_their_coordinate_frame(tmp_path):
    boxes = Boxes2D(np.array(["?"]), np.array([[1.0, 2, 3, 4]]))
    image = decodes(kind="camera", topics=["/dev/data"])(lambda payload: RESULTS["camera"])
    both = decodes("acme.Data", kind="boxes", topics=["/labels*"])(
        lambda payload: BoxesIn(Truth(7, 0, None, boxes), "dev")
    )
    write(tmp_path / "a.mcap", [b"\1"])
    write(tmp_path / "b.mcap", [b"\1"], topic="/labels", tf=False)
    setup = Setup(decoders=(NamedDecoder("image", image, True), NamedDecoder("boxes", both, True)))
    reader = open_log(tmp_path, FaultLog(), (), setup)
    [truth] = reader.truths()
    assert (truth.boxes2d.camera.tolist(), truth.boxes2d.xyxy_px.tolist()) == (["dev"], [[1, 2, 3, 4]])


def test_a_message_of_nothing_is_passed_over_and_no_fault(tmp_path):
    decoder = decodes("acme.Data", kind="lidar")(lambda payload: cloud(payload) if payload.data != b"x" else None)
    reader, faults = opened(tmp_path, decoder, [b"x"] * 50 + [b"\1", b"x", b"\2"])
    assert [message.log_ns for message in reader.messages()] == [1050, 1052]
    assert not faults.counts


def test_arrays_are_copied_because_a_decoder_may_fill_them_again(tmp_path):
    buffer = np.zeros((1, 3), np.float32)

    def read(payload):
        buffer[:] = payload.data[0]
        return PointCloud("dev", payload.log_ns * 10**9, 0, buffer)

    reader, _ = opened(tmp_path, decodes("acme.Data", kind="lidar")(read), [b"\1", b"\2"])
    assert [message.xyz[0, 0] for message in list(reader.messages())] == [1, 2]


def raises(error):
    def read(payload):
        raise error

    return read


@pytest.mark.parametrize(
    ("kind", "read", "reason"),
    [
        ("lidar", raises(ZeroDivisionError("oh\nno")), "ZeroDivisionError: oh (test_plugin.py:"),
        ("lidar", raises(SystemExit(3)), "SystemExit: 3 (test_plugin.py:"),
        ("lidar", raises(ConfigError("no such thing")), "no such thing"),
        ("lidar", lambda p: p.message, "encoding 'acme' has no general decoder; read the bytes, `payload.data`"),
        ("lidar", lambda p: 3, "gave int, expected PointCloud"),
        ("lidar", lambda p: RESULTS["radar"], "gave RadarScan, expected PointCloud"),
        ("boxes", lambda p: RESULTS["radar"], "gave RadarScan, expected Truth or BoxesIn"),
        ("lidar", lambda p: cloud(p, xyz=np.zeros((2, 3))), "expected float32 (N, 3), got float64 (2, 3)"),
        ("lidar", lambda p: cloud(p, ring=np.zeros(7, np.uint16)), "PointCloud.ring: expected uint16 ("),
        ("lidar", lambda p: cloud(p, stamp_ns=1.5), "gave stamp_ns 1.5, expected an int"),
        ("lidar", lambda p: cloud(p, stamp_ns=-1), "gave stamp_ns -1, outside 0 to 9223372036854775807"),
        ("lidar", lambda p: cloud(p, stamp_ns=2**63), "outside 0 to 9223372036854775807"),
        ("lidar", lambda p: cloud(p, frame_number=-1), "gave frame_number -1, outside 0 to 4294967295"),
        ("lidar", lambda p: cloud(p, sensor=None), "gave a sensor None, expected the name of a coordinate frame"),
        ("lidar", lambda p: cloud(p, sensor="s" * 1001), "expected the name of a coordinate frame"),
        (
            "camera",
            lambda p: Image("dev", 7, 0, b"GIF89a", "jpeg", (2, 2)),
            "neither a JPEG nor a PNG nor a WebP image",
        ),
        (
            "camera",
            lambda p: Image("dev", 7, 0, bytes(11), "rgb8", (2, 2)),
            "rgb8 image of 2x2 px with rows of 6 bytes",
        ),
        ("camera", lambda p: Image("dev", 7, 0, bytes(12), "rgb8", (2, None)), "gave an Image with size_wh (2, None)"),
        ("camera", lambda p: Image("dev", 7, 0, b"", "rgb8", (2**20, 2**20)), "is larger than"),
        ("camera", lambda p: Image("dev", 7, 0, bytes(12), "mjpg", (2, 2)), "compressed ones are jpeg, jpg, png, webp"),
        ("camera", lambda p: Image("dev", 7, 0, "text", "rgb8", (2, 2)), "gave an Image of str, expected bytes"),
        ("boxes", lambda p: Truth(7, 0), "gave a Truth without boxes"),
        ("boxes", lambda p: Truth(7, 0, BOXES, Boxes2D.empty()), "with boxes3d and boxes2d; give one of them"),
        ("boxes", lambda p: Truth(7, 0, Boxes2D.empty()), "gave Boxes2D, expected Boxes3D"),
        ("boxes", lambda p: BoxesIn(BOXES, "dev"), "gave BoxesIn of Boxes3D and str"),
        ("boxes", lambda p: BoxesIn(Truth(7, 0, BOXES), None), "gave BoxesIn of Truth and NoneType"),
        (
            "boxes",
            lambda p: Truth(7, 0, Boxes3D(np.full((1, 3), np.nan), np.ones((1, 3)), np.zeros(1))),
            "isn't finite",
        ),
    ],
)
def test_what_a_decoder_raises_or_returns_wrongly_is_one_line_with_topic_and_stamp(tmp_path, kind, read, reason):
    def read_second(payload):
        good = {**RESULTS, "boxes": Truth(7, 0, BOXES)}[kind]
        return good if payload.data == b"\1" else read(payload)

    reader, faults = opened(tmp_path, decodes("acme.Data", kind=kind)(read_second), [b"\1", b"\2"], topic="/gt")
    assert len([*reader.messages(), *reader.truths()]) == 1
    [place] = faults.places["DEC001"]
    assert place.startswith("log.mcap: /gt at 1000: decoder 'acme.py:read': ")
    assert reason in place
    assert place.isprintable()
    assert faults.counts == {"DEC001": 1}


def test_a_decoder_of_video_gives_packets_and_fbench_follows_the_pictures(tmp_path):
    packets = encode(num=6, key_every=3)

    def read(payload):
        return Image("dev", payload.publish_ns, 0, payload.data, "h264", (0, 0))

    reader, faults = opened(tmp_path, decodes("acme.Data", kind="camera")(read), packets)
    found = list(reader.messages())
    assert [image.video.index for image in found] == [0, 1, 2] * 2
    assert {image.size_wh for image in found} == {SIZE}
    assert not faults.counts


def test_what_the_users_decoder_reads_counts_as_points(tmp_path):
    """Whatever the vendor calls the type: a planar scan of the same sensor is left out, not this."""
    scan = {"frame_id": "dev", "start_angle": 0, "end_angle": 1, "ranges": [2, 3]}
    decoder = decodes("acme.ObjectList", kind="lidar")(cloud)
    path = tmp_path / "log.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        for topic, schema, encoding, data in (
            ("/scan", "foxglove.LaserScan", "json", json.dumps(scan).encode()),
            ("/dev/data", "acme.ObjectList", "acme", b"1"),
        ):
            channel = writer.register_channel(topic, encoding, writer.register_schema(schema, "", b""))
            writer.add_message(channel, 1000, data, 1000)
        writer.finish()
    faults = FaultLog()
    reader = open_log(path, faults=faults, setup=Setup(decoders=(NamedDecoder("acme.py:read", decoder),)))
    assert {role.topic: role.sensor for role in reader.roles.values()} == {"/dev/data": "dev"}
    assert faults.counts == {"LOG012": 1}


def test_an_interrupt_is_none_of_its_failures(tmp_path):
    with pytest.raises(TerminatedError):
        opened(tmp_path, decodes("acme.Data", kind="lidar")(raises(TerminatedError())))


@pytest.mark.parametrize(
    ("types", "topics", "found"),
    [
        (["acme.Data"], [], True),
        (["acme.Other", "acme.Data"], [], True),
        (["acme.Other"], [], False),
        ([], ["/dev/*"], True),
        ([], ["/other"], False),
        (["acme.Data"], ["/other"], False),
        (["acme.Data"], ["/other", "/dev/?ata"], True),
    ],
)
def test_types_and_topics_decide_which_messages_are_its_own(tmp_path, types, topics, found):
    decoder = decodes(*types, kind="lidar", topics=topics)(cloud)
    reader, _ = opened(tmp_path, decoder, is_required=False)
    assert len(list(reader.messages())) == found


def test_topics_alone_do_where_the_log_has_no_schema(tmp_path):
    reader, _ = opened(tmp_path, decodes(kind="lidar", topics=["/dev/data"])(cloud), schema="")
    assert len(list(reader.messages())) == 1


@pytest.mark.parametrize("name", ["acme_msgs/Data", "acme_msgs/msg/Data"])
def test_names_of_ros_types_are_the_same_in_both_forms(name):
    decoder = decodes(name, kind="lidar")(cloud)
    assert decoder.fits("/a", "acme_msgs/Data")
    assert decoder.fits("/a", "acme_msgs/msg/Data")
    assert not decoder.fits("/a", "acme_msgs/msg/Datum")


@pytest.mark.parametrize(
    ("decoder", "text"),
    [
        (decodes("acme.Date", kind="lidar")(cloud), "no acme.Date; did you mean 'acme.Data'?"),
        (decodes(kind="lidar", topics=["/dev/date"])(cloud), "no a topic like /dev/date; did you mean '/dev/data'?"),
    ],
)
def test_a_decoder_that_is_for_nothing_in_the_log(tmp_path, decoder, text):
    with pytest.raises(ConfigError) as caught:
        opened(tmp_path, decoder)
    assert str(caught.value) == f"--decoder acme.py:read: the log has {text}"


@pytest.mark.parametrize(
    ("types", "how", "text"),
    [((), {"kind": "lidar"}, "name the types"), (("a",), {"kind": "sonar"}, "kind 'sonar' is none of camera, lidar")],
)
def test_what_cannot_be_declared(types, how, text):
    with pytest.raises(ConfigError, match=text):
        decodes(*types, **how)


def test_a_decoder_goes_before_what_is_built_in(tmp_path):
    decoder = decodes("foxglove.PointCloud", kind="lidar")(cloud)
    reader, _ = opened(tmp_path, decoder, schema="foxglove.PointCloud", encoding="protobuf")
    assert [message.xyz[0, 0] for message in reader.messages()] == [1]


def test_a_decoder_that_conforms(tmp_path):
    write(tmp_path / "log.mcap", [b"x", b"\1", b"\2"])
    decoder = decodes("acme.Data", kind="lidar")(lambda p: None if p.data == b"x" else cloud(p))
    assert check_decoder(decoder, tmp_path / "log.mcap") == 2


class Counting:
    """Gives another point each time."""

    num = 0

    def __call__(self, payload):
        self.num += 1
        return PointCloud("dev", 7, 0, np.full((1, 3), self.num, np.float32))


@pytest.mark.parametrize(
    ("decoder", "text"),
    [
        (decodes("acme.Other", kind="lidar")(cloud), "no topic is of a type that the decoder names"),
        (decodes("acme.Data", kind="lidar")(lambda p: None), "every message gives None"),
        (
            decodes("acme.Data", kind="lidar")(lambda p: RESULTS["pose"]),
            "at 1000: decoder 'checked': gave Pose, expected PointCloud",
        ),
        (decodes("acme.Data", kind="lidar")(Counting()), "at 1000: gives another result where other messages come"),
        (decodes("acme.Data", kind="lidar")(lambda p: cloud(p, sensor=f"s{p.data[0]}")), "several sensors: s1, s2"),
    ],
)
def test_decoders_that_do_not_conform(tmp_path, decoder: Decoder, text):
    write(tmp_path / "log.mcap", [b"\1", b"\2"])
    with pytest.raises(AssertionError, match=text):
        check_decoder(decoder, tmp_path / "log.mcap")
