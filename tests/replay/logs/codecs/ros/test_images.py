import cv2
import numpy as np
import pytest
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP_NS, Ros

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.images import decode

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
JAZZY = Ros(DISTROS[1])
PIXELS = np.random.Generator(np.random.Philox(2)).integers(0, 255, (4, 6, 3)).astype(np.uint8)
DATA = PIXELS.tobytes()


def raw(ros=JAZZY, encoding="bgr8", data=DATA, size_wh=(6, 4), step=18, is_bigendian=0):
    fields = {"height": size_wh[1], "width": size_wh[0], "encoding": encoding, "is_bigendian": is_bigendian}
    return ros.write(ros.make(RAW, ros.header("/cam"), **fields, step=step, data=np.frombuffer(bytes(data), np.uint8)))


def compressed(form, data, ros=JAZZY):
    return ros.write(ros.make(COMPRESSED, ros.header("cam"), form, np.frombuffer(bytes(data), np.uint8)))


def read(name, data, ros=JAZZY):
    return ros.codec(name).message("camera", data, ORIGIN)


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize("big", [False, True])
def test_raw_images_of_all_distributions(distro, big):
    ros = Ros(distro, big=big)
    padded = np.concatenate([PIXELS.reshape(4, 18), np.full((4, 5), 99, np.uint8)], axis=1)
    data = raw(ros, data=padded.tobytes(), step=23)
    codec = ros.codec(RAW)
    assert codec.kinds == ("camera",)
    assert codec.probe(data)[:2] == ("camera", "cam")
    image = codec.message("camera", data, ORIGIN)
    assert (image.sensor, image.stamp_ns, image.log_ns, image.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    assert (image.encoding, image.size_wh, image.data) == ("bgr8", (6, 4), PIXELS.tobytes())
    np.testing.assert_array_equal(decode(image), PIXELS)


@pytest.mark.parametrize(("given", "name"), [("8UC3", "bgr8"), ("rgb8", "rgb8")])
def test_names_of_encodings(given, name):
    assert read(RAW, raw(encoding=given)).encoding == name


def test_big_endian_16_bits_are_stored_little_endian():
    image = read(RAW, raw(encoding="mono16", data=b"\x01\x02\x03\x04", size_wh=(2, 1), step=4, is_bigendian=1))
    assert image.data == b"\x02\x01\x04\x03"
    assert decode(image)[0, :, 0].tolist() == [1, 3]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"encoding": "32FC1"}, "encoding '32FC1' is that of a depth image"),
        ({"step": 19, "data": bytes(75)}, "rows of 19 bytes has 75 bytes"),
        ({"size_wh": (7, 4)}, "bgr8 image of 7x4 px"),
        ({"size_wh": (2**31, 2**31)}, "larger than 178956970 px"),
        ({"size_wh": (0, 0), "data": b""}, "0x0"),
    ],
)
def test_damaged_raw_images(changes, message):
    with pytest.raises(DecodeError, match=message):
        read(RAW, raw(**{"step": 18, **changes}))


def encoded(suffix):
    return cv2.imencode(suffix, PIXELS)[1].tobytes()


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize(
    ("form", "suffix", "encoding"),
    [
        ("rgb8; jpeg compressed bgr8", ".jpg", "jpeg"),
        ("jpg", ".jpg", "jpeg"),
        ("jpeg", ".png", "png"),
        ("bgr8; png compressed bgr8", ".png", "png"),
        ("", ".webp", "webp"),
    ],
)
def test_compressed_images(distro, form, suffix, encoding):
    ros = Ros(distro)
    data = compressed(form, encoded(suffix), ros)
    assert ros.codec(COMPRESSED).probe(data)[:2] == ("camera", "cam")
    image = read(COMPRESSED, data, ros)
    assert (image.encoding, image.size_wh, image.data) == (encoding, (6, 4), encoded(suffix))
    assert image.stamp_ns == STAMP_NS


@pytest.mark.parametrize(
    ("form", "data", "message"),
    [
        ("16UC1; compressedDepth png", encoded(".png"), "'16UC1; compressedDepth png' is a depth image"),
        ("mpeg", b"\0\0\0\1abc", "neither a JPEG nor a PNG nor a WebP"),
        ("jpeg", b"", "neither"),
        ("jpeg", b"\xff\xd8\xff\xd9", "without a frame header"),
        ("png", encoded(".png")[:20], "PNG without a header"),
    ],
)
def test_compressed_images_that_cant_be_used(form, data, message):
    with pytest.raises(DecodeError, match=message):
        read(COMPRESSED, compressed(form, data))


def test_images_that_cant_be_shown_are_refused_at_the_first_look():
    for encoding in ("16UC1", "32FC1"):
        with pytest.raises(DecodeError, match=f"'{encoding}' is that of a depth image"):
            JAZZY.codec(RAW).probe(raw(encoding=encoding))
    for form in ("16UC1; compressedDepth", "16UC1; png compressed "):
        with pytest.raises(DecodeError, match="depth image"):
            JAZZY.codec(COMPRESSED).probe(compressed(form, b""))


def test_an_image_holds_nothing_else():
    codec = JAZZY.codec(RAW)
    for method in (codec.transforms, codec.calibration):
        with pytest.raises(DecodeError, match="sensor_msgs/msg/Image holds no"):
            method(raw())
    with pytest.raises(DecodeError, match="holds no box"):
        codec.truth(raw(), ORIGIN)
