"""Videos with something wrong: no picture is shown that isn't as it was recorded, and each says why."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.replay.logs import builders as b
from tests.replay.logs.codecs.video import builders as v
from tests.replay.logs.codecs.video.test_pictures import AV1, oracle, place

from fbench.replay.contracts.errors import LogError, MissingPackageError
from fbench.replay.contracts.faults import explain_losses
from fbench.replay.data import video
from fbench.replay.data.images import decode, decode_grey
from fbench.replay.data.messages import Image
from fbench.replay.logs.codecs.video import stream
from fbench.replay.logs.codecs.video.bits import B_FRAMES
from fbench.replay.logs.codecs.video.vp9_av1 import Av1Heads

PACKETS = v.encode(num=12, key_every=6)
WANTED = oracle("h264", PACKETS)
HEVC = v.encode("h265", num=12, key_every=6)


@pytest.mark.parametrize("lost", [[2], [2, 3], [7]], ids=str)
def test_a_lost_message_damages_all_up_to_the_next_keyframe(lost):
    rest = [i for i in range(12) if i not in lost]
    images = place([PACKETS[i] for i in rest])
    damaged = [i for i in rest if i // 6 == lost[0] // 6 and i > lost[-1]]
    for image, i in zip(images, rest, strict=True):
        if i in damaged:
            number = lost[-1] % 6 + 1
            why = f"a message before it is missing: picture {number} comes after {lost[0] % 6 - 1}"
            assert (image.video.damage, image.video.is_lost) == (why, True)
            assert decode(image) is decode_grey(image) is None
        else:
            v.require_same(decode(image), WANTED[i])


def test_a_lost_keyframe_is_missed():
    images = place([*PACKETS[:6], *PACKETS[7:]])
    assert [decode(image) is None for image in images] == [False] * 6 + [True] * 5


def test_lost_messages_of_h265_are_found_when_decoding():
    wanted = oracle("h265", HEVC)
    images = place([*HEVC[:2], *HEVC[3:]], "h265")
    for at, i in enumerate([0, 1, *range(3, 12)]):
        if i in (3, 4, 5):
            assert decode(images[at]) is None
        else:
            v.require_same(decode(images[at]), wanted[i])


def test_a_video_that_begins_in_the_middle():
    images = place(PACKETS[3:])
    assert [(image.video.damage, image.video.is_lost) for image in images[:3]] == [
        ("before the first keyframe", False)
    ] * 3
    for image, wanted in zip(images[3:], WANTED[6:], strict=True):
        v.require_same(decode(image), wanted)


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_b_frames_are_named(codec):
    options = {
        "tune": "psnr",
        "bf": "2",
        "x264-params": "b-adapt=0",
        "x265-params": "log-level=none:bframes=2:b-adapt=0",
    }
    images = place(v.encode(codec, **options), codec)
    assert [image.video.damage for image in images][2] == B_FRAMES


def test_a_topic_with_b_frames_is_left_out(tmp_path):
    packets = v.encode(tune="psnr", bf="2", **{"x264-params": "b-adapt=0"})
    reader, faults = b.read(v.write_log(tmp_path / "log.mcap", packets))
    assert reader.rig.kinds == {"lidar": "lidar"}
    (left_out,) = faults.places["LOG013"]
    assert "topic '/cam/video' is left out: its video has B-frames: pictures come in another order" in left_out


@pytest.mark.parametrize(
    ("packet", "why"),
    [
        (b"", "without start codes"),
        (b"\0\0\1", "without start codes|header of the video ends early|nothing"),
        (PACKETS[0][8:], "without start codes"),
        (b"\0\0\0\x20" + PACKETS[1][4:], "without start codes"),
        (b"\0\0\1\x09\xf0" * 600, "over 512 units"),
    ],
)
def test_what_is_no_packet_breaks_the_video_off(packet, why):
    images = place([*PACKETS[:3], packet, *PACKETS[3:]])
    shown = [decode(image) is not None for image in images]
    if len(images) == 12:  # it held no picture, nor anything that one needs
        assert all(shown)
        return
    assert shown == [True] * 3 + [False] * 4 + [True] * 6
    assert any(part in images[4].video.damage for part in why.split("|"))
    assert all(image.video.is_lost for image in images[3:7])


def test_an_error_for_want_of_a_camera_names_the_video(tmp_path):
    reader, faults = b.read(v.write_log(tmp_path / "log.mcap", PACKETS, "vp8"))
    assert reader.rig.kinds == {"lidar": "lidar"}
    why = "no camera; before that: .*'/cam/video' is left out: video in 'vp8' isn't supported"
    with pytest.raises(LogError, match=why), explain_losses(faults):
        raise LogError("no camera")


def golomb(value):
    text = f"{value + 1:b}"
    return "0" * (len(text) - 1) + text


def unit(head, bits):
    """A unit without bytes that keep start codes out: none of these needs any."""
    bits += "1" + "0" * (-(len(bits) + 1) % 8)
    return b"\0\0\1" + bytes([head]) + int(bits, 2).to_bytes(len(bits) // 8, "big")


def sps(width_mbs, rows, level=51):
    """A sequence parameter set of the baseline profile with this size, and a picture parameter set."""
    fields = (0, 0, 0, 0, 1)  # number, frame numbers of 4 bits, order 0 of 4 bits, one reference
    bits = f"{66:08b}{0:08b}{level:08b}" + "".join(map(golomb, fields)) + "0"
    bits += golomb(width_mbs - 1) + golomb(rows - 1) + "1" + "1" + "0" + "0"
    return unit(0x67, bits) + unit(0x68, golomb(0) + golomb(0))


def picture(number, order, head=0x41):
    """The head of a P slice with its numbers; the second byte says whether others refer to it."""
    return unit(head, golomb(0) + golomb(5) + golomb(0) + f"{number % 16:04b}{order % 16:04b}" + "10" * 20)


def idr():
    return sps(6, 4) + unit(0x65, golomb(0) + golomb(7) + golomb(0) + "0000" + golomb(0) + "0000" + "10" * 20)


def test_numbers_of_pictures_count_those_that_others_refer_to():
    """ITU-T H.264, 7.4.3: a picture that none refers to doesn't move the count on, so its loss harms nothing."""
    disposable = 0x01
    packets = [idr(), picture(1, 2, disposable), picture(1, 4), picture(2, 6, disposable), picture(2, 8)]
    packets += [picture(number, 8 + 2 * (number - 2)) for number in range(3, 40)]  # over the end of 4 bits
    for sent in (packets, [p for p in packets if p not in (packets[1], packets[3])]):
        assert [image.video.damage for image in place(sent)] == [""] * len(sent)
    damage = [image.video.damage for image in place([*packets[:4], *packets[5:]])]
    assert damage[:4] == [""] * 4
    assert set(damage[4:]) == {"a message before it is missing: picture 3 comes after 1"}


def test_pictures_that_go_back_in_order_are_b_frames():
    """Before and after the end of the 4 bits that count the order."""
    for start in (0, 6):
        steps = [idr(), *(picture(i, 2 * i) for i in range(1, start + 1))]
        later = [picture(start + 1, 2 * start + 6), picture(start + 2, 2 * start + 2)]
        assert [image.video.damage for image in place([*steps, *later])] == [""] * (start + 2) + [B_FRAMES]


@pytest.mark.parametrize(("size", "px"), [((1200, 1200), "19200x19200"), ((2**16, 2**16), "1048576x1048576")])
def test_huge_pictures_are_refused_before_they_are_decoded(size, px):
    (image,) = place([sps(*size) + b"\0\0\1\x65\x88\x84\x00\x10"])
    assert image.video.damage == f"video of {px} px, 1 to 35651584 px are read"
    assert decode(image) is None


@pytest.mark.parametrize(("codec", "packets"), [("h264", PACKETS), ("h265", HEVC), ("vp9", v.encode("vp9"))])
def test_damaged_packets_never_raise_nor_print(codec, packets, capfd):
    @settings(max_examples=40, deadline=None, derandomize=True)
    @given(st.data())
    def try_one(data):
        damaged = [bytearray(packet) for packet in packets[:7]]
        for _ in range(data.draw(st.integers(1, 4))):
            packet = damaged[data.draw(st.integers(0, 6))]
            if packet and data.draw(st.booleans()):
                packet[data.draw(st.integers(0, len(packet) - 1))] ^= 1 << data.draw(st.integers(0, 7))
            else:
                del packet[data.draw(st.integers(0, len(packet))) :]
        for image in place(map(bytes, damaged), codec):
            picture = decode(image)
            assert picture is None or picture.shape == (image.size_wh[1], image.size_wh[0], 3)

    try_one()
    assert capfd.readouterr() == ("", "")


def test_a_bit_that_flipped_damages_the_rest_up_to_the_next_keyframe():
    broken = bytearray(PACKETS[2])
    broken[4 + 1] ^= 0xFF  # the head of its slice
    images = place([*PACKETS[:2], bytes(broken), *PACKETS[3:]])
    shown = [decode(image) for image in images]
    assert [picture is None for picture in shown] == [False] * 2 + [True] * 4 + [False] * 6
    for i in (0, 1, *range(6, 12)):
        v.require_same(shown[i], WANTED[i])


def test_a_new_size_begins_with_its_keyframe():
    small = v.encode(num=3, size_wh=(64, 48))
    images = place([*PACKETS[:3], *small])
    assert [image.size_wh for image in images] == [(96, 64)] * 3 + [(64, 48)] * 3
    assert [decode(image).shape for image in images] == [(64, 96, 3)] * 3 + [(48, 64, 3)] * 3


def test_without_pyav_only_decoding_fails(monkeypatch):
    def fail():
        raise MissingPackageError("a log has video, which needs PyAV")

    monkeypatch.setattr(video, "import_av", fail)
    monkeypatch.setattr(stream, "MAX_STRETCH_BYTES", 100)
    for image in place(PACKETS):
        assert image.video.damage == ""
        with pytest.raises(MissingPackageError, match="needs PyAV"):
            decode(image)


def test_faults_of_a_log(tmp_path):
    """What is lost counts; what was never recorded is only flagged."""
    packets = PACKETS[4:]
    reader, _ = b.read(v.write_log(tmp_path / "log.mcap", packets, left_out=[3]))
    images = b.numbers(list(reader.messages()), Image)
    assert [image.video.damage for image in images] == [
        "before the first keyframe", "before the first keyframe", "",
        *["a message before it is missing: picture 2 comes after 0"] * 4,
    ]  # fmt: skip
    assert np.array_equal([image.video.is_lost for image in images], [False, False, False, True, True, True, True])


SEQUENCE = bytes.fromhex("0a0a00000002afff895f2008")
"""The sequence header of AV1 of test_pictures: order hints of seven bits, screen content and motion by frame."""


def av1(order, shown=True, again=False, key=False):
    """A packet of AV1 as far as its headers are read: one frame, that of 5.9.2 bit by bit."""
    kind, resilience = ("00", "") if key else ("01", "0")
    bits = "1" + "000" if again else f"0{kind}{int(shown)}{'' if shown else '0'}{resilience if shown else '0'}00"
    bits += "" if again else f"0{order % 128:07b}"
    frame = int(bits.ljust(64, "0"), 2).to_bytes(8, "big")
    unit = bytes([0x32, len(frame)]) + frame
    return b"\x12\0" + (SEQUENCE if key else b"") + unit


def lost(packets):
    heads = Av1Heads()
    return [head.lost for packet in packets if (head := heads.read(packet)) is not None]


def test_lost_messages_of_av1_are_told_by_order_hints():
    hidden = av1(9, shown=False)[2:]  # a later picture that comes before
    good = [av1(0, key=True), av1(1), av1(2), av1(3), av1(4)]
    assert lost(good) == [""] * 5
    assert lost([good[0], *good[2:]])[1] == "a message before it is missing: picture 2 comes after 0"
    assert lost([*good[:3], good[4]])[3] == "a message before it is missing: picture 4 comes after 2"
    assert lost([av1(126, key=True), av1(127), av1(0)]) == [""] * 3  # it has seven bits
    assert lost([good[0], good[2][:2] + hidden + av1(1)[2:], av1(2)]) == [""] * 3
    assert lost([good[0], av1(0, again=True), av1(2)]) == [""] * 3  # shows a picture that came before
    assert lost([good[0], av1(0, again=True), av1(3)])[2].startswith("a message before it is missing")
    assert lost([good[0], good[1], av1(50, key=True), av1(51)]) == [""] * 4  # keyframes begin anew


def test_a_lost_message_of_av1_shows_no_picture_until_the_next_keyframe():
    packets = [bytes.fromhex(text) for text in AV1]
    images = place([packets[0], packets[2], *packets], "av1")
    assert [image.video.damage[:33] for image in images] == ["", "a message before it is missing: p", "", "", ""]
    assert images[1].video.is_lost
    again = place([packets[0], packets[1], packets[1], packets[2]], "av1")  # recorded twice
    assert [image.video.index for image in again] == [0, 1, 1, 2]
    assert not any(image.video.damage for image in again)


@pytest.mark.parametrize(("codec", "is_flagged"), [("vp9", True), ("h264", False), ("av1", False)])
def test_videos_whose_losses_go_unseen_are_flagged(tmp_path, codec, is_flagged):
    packets = [bytes.fromhex(text) for text in AV1] if codec == "av1" else v.encode(codec)
    reader, faults = b.read(v.write_log(tmp_path / "log.mcap", packets, codec))
    assert len(b.numbers(list(reader.messages()), Image)) == len(packets)
    list(reader.messages())
    assert faults.counts["DEC006"] == is_flagged  # once
    assert not faults.num_lost
