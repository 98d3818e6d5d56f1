"""Each picture is that of decoding the whole video in order, whichever are looked at, when, and by whom."""

from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import pytest
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.video import builders as v

from fbench.replay.data.images import decode, decode_grey
from fbench.replay.data.messages import Image
from fbench.replay.logs.codecs.video import stream
from fbench.replay.logs.codecs.video.stream import VideoStream

AV1 = [
    (
        "12000a0a00000002afff895f200832a3011000d200a2851410000086ee0c45b15ef2cdf71ec23d75c34138acf1b47adf64bc15ab"
        "9c29ed7d7609668d81df75682c9ab668816fe233c0cbd14c14c03c44ce9bc3a47ad44847edc52341f953d808a90c7d58559796d8"
        "8a0fe6bbb7277f7f7eafd987a7304984ef90eddd2f070655e002bfc9a56c4fec3c826612b82b9825396de3726912cf4d0a4f37b1"
        "43320367419c3d43ad93142e4fba5b90ffce1483e5ecb799"
    ),
    "1200321130020000000023e00000020002009b7b40",
    "1200321130040080000023bc0000020002009b7cd0",
]
"""Packets of libsvtav1 4.1, 64x64 px, with low delay: its messages would go to stdout."""


def place(packets, codec="h264"):
    """Messages of a camera, as a log gives them; parameter sets alone give none."""
    videos = VideoStream()
    taken = (videos.take(Image("cam", i, i, packet, codec, (0, 0))) for i, packet in enumerate(packets))
    return [image for image in taken if image is not None]


def oracle(codec, packets):
    return [v.to_bgr(frame) for frame in v.decode_all(codec, packets)]


@pytest.mark.parametrize("codec", ["h264", "h265", "vp9"])
@pytest.mark.parametrize("size_wh", [(96, 64), (130, 94)], ids=str)
def test_pictures_of_a_log_are_those_of_sequential_decoding(tmp_path, codec, size_wh):
    packets = v.encode(codec, size_wh=size_wh)
    reader, faults = b.read(v.write_log(tmp_path / "log.mcap", packets, codec, size_wh=size_wh))
    assert reader.rig.kinds == {"cam": "camera", "lidar": "lidar"}
    images = b.numbers(list(reader.messages()), Image)
    assert [image.data for image in images] == packets
    assert {(image.encoding, image.size_wh) for image in images} == {(codec, size_wh)}
    assert [image.stamp_ns for image in images] == [v.START + i * 100 * v.MS for i in range(12)]
    for image, wanted, drawn in zip(images, oracle(codec, packets), v.pictures(12, size_wh), strict=True):
        v.require_same(decode(image), wanted)
        assert np.abs(wanted - drawn).mean() < 12  # it is the picture that was drawn
        np.testing.assert_allclose(decode_grey(image), cv2.cvtColor(decode(image), cv2.COLOR_BGR2GRAY), atol=8)
    assert dict(faults.counts) == ({"DEC006": 1} if codec == "vp9" else {})


def test_pictures_of_av1(tmp_path):
    packets = [bytes.fromhex(text) for text in AV1]
    images = place(packets, "av1")
    assert [image.size_wh for image in images] == [(64, 64)] * 3
    assert [image.video.index for image in images] == [0, 1, 2]
    for image, wanted in zip(images, oracle("av1", packets), strict=True):
        v.require_same(decode(image), wanted)


def test_neither_order_nor_threads_nor_what_is_left_out_matter():
    packets = v.encode(num=20, key_every=8)
    wanted = oracle("h264", packets)
    images = place(packets)
    for i in (17, 3, 2, 3, 19, 0, 8, 7):
        v.require_same(decode(images[i]), wanted[i])
    images = place(packets)
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(decode, [images[i] for i in range(19, -1, -3)] * 2))
    for picture, i in zip(found, [*range(19, -1, -3)] * 2, strict=True):
        v.require_same(picture, wanted[i])


@pytest.mark.parametrize(
    ("form", "tags", "rule"),
    [
        ("yuv420p", {"colorspace": 1}, {"red": 0.2126, "blue": 0.0722}),
        ("yuv420p", {"colorspace": 5}, {}),
        ("yuvj420p", {"color_range": 2}, {"full": True}),
        ("yuv422p", {}, {}),
        ("yuv444p", {"colorspace": 9}, {"red": 0.2627, "blue": 0.0593}),
        ("yuv420p10le", {"colorspace": 1}, {"red": 0.2126, "blue": 0.0722, "depth": 10}),
    ],
)
def test_colors_follow_matrix_and_range_of_the_video(form, tags, rule):
    packets = v.encode(num=3, form=form, tags=tuple(tags.items()))
    for image, frame in zip(place(packets), v.decode_all("h264", packets), strict=True):
        v.require_same(decode(image), v.to_bgr(frame, **rule))


def test_grey_and_rgb_video():
    (grey,) = place(v.encode(num=1, form="gray", tags=(("color_range", 2),)))
    (frame,) = v.decode_all("h264", [grey.data])
    np.testing.assert_array_equal(decode(grey), np.repeat(np.array(v.planes(frame)[0])[:, :, None], 3, axis=2))
    np.testing.assert_array_equal(decode_grey(grey), v.planes(frame)[0])


# --- parameter sets, repeats, recovery, long stretches ---


def split_sets(packet):
    """Units before the picture, and the rest."""
    at = max(packet.find(b"\0\0\1" + kind) for kind in (b"\x65", b"\x26", b"\x28", b"\x2a"))
    at -= packet[at - 1] == 0
    return packet[:at], packet[at:]


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_parameter_sets_in_a_message_of_their_own_or_only_at_the_start(codec):
    packets = v.encode(codec)
    wanted = oracle(codec, packets)
    (sets, first), (_, second) = split_sets(packets[0]), split_sets(packets[6])
    for given in ([sets, first, *packets[1:]], [*packets[:6], second, *packets[7:]]):
        images = place(given, codec)
        assert len(images) == 12
        for i in (11, 8, 2):
            v.require_same(decode(images[i]), wanted[i])


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_videos_that_announce_b_frames_but_have_none_are_shown_at_once(codec):
    """Decoders would hold each picture back until later ones come."""
    options = {"tune": "psnr", "bf": "3", "x265-params": "log-level=none:bframes=3", "forced-idr": "1"}
    packets = v.encode(codec, num=8, key_every=100, p_only=True, **options)
    assert v.decode_first(codec, packets[:1]) == []
    wanted = oracle(codec, packets)
    _, second = split_sets(packets[0])
    for given in (packets, [packets[0], second, *packets[1:]]):
        for image, expected in zip(place(given, codec)[-7:], wanted[1:], strict=True):
            v.require_same(decode(image), expected)


def test_a_message_that_comes_twice_is_one_picture():
    packets = v.encode()
    wanted = oracle("h264", packets)
    images = place([*packets[:4], packets[3], *packets[4:]])
    assert [image.video.damage for image in images] == [""] * 13
    for image, expected in zip(images, [*wanted[:4], wanted[3], *wanted[4:]], strict=True):
        v.require_same(decode(image), expected)


def test_a_video_refreshed_part_by_part_recovers():
    packets = v.encode(num=30, key_every=10, **{"x264-params": "intra-refresh=1"})
    wanted = oracle("h264", packets)
    images = place([*packets[:4], *packets[5:]])
    shown = [decode(image) for image in images]
    assert [picture is not None for picture in shown[:5]] == [True] * 4 + [False]
    back = next(i for i in range(4, 29) if shown[i] is not None)
    assert 8 < back < 20
    assert all(picture is not None for picture in shown[back:])
    assert images[back - 1].video.damage == "still being built after a point of recovery"
    for i in range(back + 10, 29):  # a second refresh replaces what the first one could still predict from the loss
        v.require_same(shown[i], wanted[i + 1])


def test_a_keyframe_that_is_no_idr():
    """As open groups of pictures have it: an intra picture with a point of recovery in 0 pictures."""
    packets = v.encode(num=18, key_every=6, tune="psnr", bf="1", p_only=True, **{"x264-params": "open-gop=1"})
    assert [b"\0\0\1\x65" in packet for packet in packets] == [True] + [False] * 17
    wanted = oracle("h264", packets)
    rest = [*range(3), *range(4, 18)]
    for image, i in zip(place([packets[i] for i in rest]), rest, strict=True):
        if i in (4, 5):
            assert decode(image) is None
        else:
            v.require_same(decode(image), wanted[i])


def test_pictures_far_from_their_keyframe_need_no_more_memory(monkeypatch):
    packets = v.encode(num=20, key_every=100)
    wanted = oracle("h264", packets)
    monkeypatch.setattr(stream, "MAX_STRETCH_BYTES", sum(map(len, packets[:6])))
    images = place(packets)
    kept = images[0].video.source.packets
    assert len(kept) == 7
    for i in (19, 8, 3, 6, 7, 19):
        v.require_same(decode(images[i]), wanted[i])
