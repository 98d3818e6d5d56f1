import struct

import cv2
import numpy as np
import pytest

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.images import decode, decode_grey, encode_jpeg, read_size, scale_down
from fbench.replay.data.messages import Image

PIXELS = np.random.Generator(np.random.Philox(1)).integers(0, 255, (6, 8, 3)).astype(np.uint8)


def image(data, encoding, size_wh=(8, 6)):
    return Image("cam", 0, 0, bytes(data), encoding, size_wh)


def png(pixels=PIXELS):
    return cv2.imencode(".png", pixels)[1].tobytes()


def test_png_is_decoded_exactly():
    np.testing.assert_array_equal(decode(image(png(), "png")), PIXELS)


def test_raw_layouts():
    np.testing.assert_array_equal(decode(image(PIXELS.tobytes(), "bgr8")), PIXELS)
    np.testing.assert_array_equal(decode(image(PIXELS[..., ::-1].tobytes(), "rgb8")), PIXELS)
    grey = PIXELS[..., 0]
    np.testing.assert_array_equal(decode(image(grey.tobytes(), "mono8")), np.stack([grey] * 3, axis=2))


@pytest.mark.parametrize(
    "bad",
    [
        image(b"", "jpeg"),
        image(b"no image", "jpeg"),
        image(png()[:40], "png"),
        image(png(), "png", (9, 6)),
        image(encode_jpeg(PIXELS)[:60], "jpeg"),
        image(b"abc", "rgb8"),
        image(png(), "png", (0, 0)),
    ],
)
def test_corrupt_images_give_none(bad):
    assert decode(bad) is None


def test_bomb_is_refused_before_it_is_decoded():
    header = b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sII", 13, b"IHDR", 30000, 30000)
    assert decode(image(header, "png", (30000, 30000))) is None


def test_encoded_size():
    assert read_size(png()) == (8, 6)
    assert read_size(encode_jpeg(PIXELS)) == (8, 6)
    with pytest.raises(DecodeError, match="neither"):
        read_size(b"GIF89a")
    with pytest.raises(DecodeError, match="without a frame header"):
        read_size(b"\xff\xd8\xff\xd9")


def test_resized_keeps_the_aspect_and_never_enlarges():
    assert scale_down(PIXELS, 4).shape == (3, 4, 3)
    assert scale_down(PIXELS, 100) is PIXELS


def test_grey_is_the_brightness_of_the_colors():
    """Within rounding: a JPEG stores brightness, from which colors follow."""
    v, u = np.indices((48, 64))
    bgr = np.stack([2 * u + 40, 3 * v + 50, 3 * (u + v) // 2 + 30], axis=2).astype(np.uint8)
    data = encode_jpeg(bgr, 95)
    grey = decode_grey(Image("cam", 0, 0, data, "jpeg", (64, 48)))
    colors = decode(Image("cam", 0, 0, data, "jpeg", (64, 48)))
    assert grey is not None
    assert colors is not None
    assert np.abs(grey.astype(int) - cv2.cvtColor(colors, cv2.COLOR_BGR2GRAY)).max() <= 2
    raw = decode_grey(Image("cam", 0, 0, bgr.tobytes(), "bgr8", (64, 48)))
    np.testing.assert_array_equal(raw, cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))


@pytest.mark.parametrize(
    "bad",
    [
        Image("cam", 0, 0, b"not a jpeg", "jpeg", (4, 4)),
        Image("cam", 0, 0, encode_jpeg(np.zeros((8, 8, 3), np.uint8)), "jpeg", (4, 4)),
        Image("cam", 0, 0, b"123", "bgr8", (4, 4)),
        Image("cam", 0, 0, b"123", "jpeg", (1 << 20, 1 << 20)),
        Image("cam", 0, 0, b"123", "jpeg", (0, 0)),
    ],
)
def test_no_grey_of_what_is_corrupt(bad):
    assert decode_grey(bad) is None
