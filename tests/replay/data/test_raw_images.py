import cv2
import numpy as np
import pytest

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.images import LAYOUTS, decode, layout_name, pack_rows, read_size, sniff_format
from fbench.replay.data.messages import Image

RED = {"R": 200, "G": 20, "B": 10}


def bgr(data, encoding, size_wh):
    return decode(Image("cam", 0, 0, bytes(data), encoding, size_wh))


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
@pytest.mark.parametrize("bits", [8, 16])
def test_bayer_patterns_give_the_color_that_was_seen(pattern, bits):
    """A sensor under a red light: each pixel has the value of the color of its filter, named row by row."""
    cell = np.array([RED[c] for c in pattern.upper()]).reshape(2, 2)
    mosaic = np.tile(cell, (4, 4)).astype(np.uint8)
    data = mosaic if bits == 8 else (mosaic.astype("<u2") << 8 | 0x55)
    pixels = bgr(data.tobytes(), f"bayer_{pattern}{bits}", (8, 8))
    np.testing.assert_array_equal(pixels[2:-2, 2:-2], np.full((4, 4, 3), [10, 20, 200]))


ONE = {
    "mono8": ([7], [7, 7, 7]),
    "bgr8": ([1, 2, 3], [1, 2, 3]),
    "rgb8": ([1, 2, 3], [3, 2, 1]),
    "bgra8": ([1, 2, 3, 9], [1, 2, 3]),
    "rgba8": ([1, 2, 3, 9], [3, 2, 1]),
    "mono16": ([0xFF, 7], [7, 7, 7]),
    "bgr16": ([0xFF, 1, 0xFF, 2, 0, 3], [1, 2, 3]),
    "rgb16": ([0xFF, 1, 0xFF, 2, 0, 3], [3, 2, 1]),
    "bgra16": ([0, 1, 0, 2, 0, 3, 0, 9], [1, 2, 3]),
    "rgba16": ([0, 1, 0, 2, 0, 3, 0, 9], [3, 2, 1]),
}


@pytest.mark.parametrize("encoding", ONE)
def test_single_pixels(encoding):
    data, expected = ONE[encoding]
    np.testing.assert_array_equal(bgr(data, encoding, (1, 1)), [[expected]])


GREY = [[[130, 130, 130]] * 2]  # Y = 128 of the range 16 to 235, no color


@pytest.mark.parametrize(
    ("encoding", "data", "size_wh", "expected"),
    [
        ("uyvy", [128, 128, 128, 128], (2, 1), GREY),
        ("yuyv", [128, 128, 128, 128], (2, 1), GREY),
        ("uyvy", [128, 16, 128, 235], (2, 1), [[[0] * 3, [255] * 3]]),
        ("yuyv", [16, 128, 235, 128], (2, 1), [[[0] * 3, [255] * 3]]),
        ("nv21", [16, 235, 235, 16, 128, 128], (2, 2), [[[0] * 3, [255] * 3], [[255] * 3, [0] * 3]]),
    ],
)
def test_yuv(encoding, data, size_wh, expected):
    np.testing.assert_allclose(bgr(data, encoding, size_wh), expected, atol=1)


@pytest.mark.parametrize(
    ("encoding", "data"), [("uyvy", [90, 81, 240, 81]), ("yuyv", [81, 90, 81, 240]), ("nv21", [81] * 4 + [240, 90])]
)
def test_order_of_the_colors_in_yuv(encoding, data):
    """BT.601 codes pure red as Y, U, V = 81, 90, 240."""
    pixels = bgr(data, encoding, (2, len(data) // 4 if encoding != "nv21" else 2))
    np.testing.assert_allclose(pixels[0, 0], [0, 0, 255], atol=3)


@pytest.mark.parametrize("encoding", LAYOUTS)
def test_wrong_sizes_give_none(encoding):
    assert bgr(b"123", encoding, (4, 4)) is None
    assert bgr(b"", encoding, (30000, 30000)) is None


def test_odd_yuv_gives_none():
    assert bgr(bytes(6), "uyvy", (3, 1)) is None
    assert bgr(bytes(9), "nv21", (3, 2)) is None


def test_padding_at_the_end_of_rows_is_removed():
    rows = np.arange(24, dtype=np.uint8).reshape(2, 12)
    assert pack_rows(memoryview(rows.tobytes()), "bgr8", (3, 2), 12) == rows[:, :9].tobytes()
    assert pack_rows(memoryview(rows[:, :9].tobytes()), "bgr8", (3, 2), 12) == rows[:, :9].tobytes()
    nv21 = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert pack_rows(memoryview(nv21.tobytes()), "nv21", (2, 2), 4) == nv21[:, :2].tobytes()


def test_big_endian_samples_are_swapped():
    assert pack_rows(memoryview(b"\x12\x34\x56\x78"), "mono16", (2, 1), 4, is_bigendian=True) == b"\x34\x12\x78\x56"
    assert pack_rows(memoryview(b"\x12\x34--\x56\x78--"), "mono16", (1, 2), 4, is_bigendian=True) == b"\x34\x12\x78\x56"
    assert pack_rows(memoryview(b"\x12\x34"), "mono8", (2, 1), 2, is_bigendian=True) == b"\x12\x34"


@pytest.mark.parametrize(
    ("data", "encoding", "size_wh", "step", "message"),
    [
        (b"12345", "mono8", (2, 2), 2, "mono8 image of 2x2 px with rows of 2 bytes has 5 bytes"),
        (b"1234", "mono8", (4, 2), 2, "rows of 2 bytes"),
        (b"", "mono8", (0, 0), 0, "0x0"),
        (b"123456", "uyvy", (3, 1), 6, "sides must be even"),
    ],
)
def test_sizes_that_dont_fit(data, encoding, size_wh, step, message):
    with pytest.raises(DecodeError, match=message):
        pack_rows(memoryview(data), encoding, size_wh, step)


def test_names_of_layouts():
    assert [layout_name(n) for n in ("8UC1", "8UC3", "16UC3", "yuv422", "yuv422_yuy2", "rgb8")] == [
        "mono8", "bgr8", "bgr16", "uyvy", "yuyv", "rgb8",
    ]  # fmt: skip
    with pytest.raises(DecodeError, match="encoding '64FC1' isn't supported, only mono8"):
        layout_name("64FC1")
    for depth in ("16UC1", "32FC1"):
        with pytest.raises(DecodeError, match=f"encoding '{depth}' is that of a depth image"):
            layout_name(depth)


PIXELS = np.random.Generator(np.random.Philox(1)).integers(0, 255, (6, 8, 3)).astype(np.uint8)


def webp(quality):
    return cv2.imencode(".webp", PIXELS, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


def test_webp_is_decoded_and_its_size_read():
    lossless, lossy = webp(101), webp(90)
    assert (lossless[12:16], lossy[12:16]) == (b"VP8L", b"VP8 ")
    for data in (lossless, lossy):
        assert sniff_format(data) == "webp"
        assert read_size(data) == (8, 6)
    np.testing.assert_array_equal(bgr(lossless, "webp", (8, 6)), PIXELS)
    assert bgr(lossy, "webp", (8, 6)).shape == (6, 8, 3)
    assert bgr(lossy, "webp", (9, 6)) is None


def test_extended_webp():
    extended = b"RIFF" + bytes(4) + b"WEBPVP8X" + (10).to_bytes(4, "little") + bytes(4)
    assert read_size(extended + (399).to_bytes(3, "little") + (299).to_bytes(3, "little")) == (400, 300)
    with pytest.raises(DecodeError, match="WebP without a frame header"):
        read_size(extended)


def test_webp_with_transparency():
    data = cv2.imencode(".webp", np.dstack([PIXELS, PIXELS[..., :1]]), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes()
    assert read_size(data) == (8, 6)
    assert bgr(data, "webp", (8, 6)).shape == (6, 8, 3)
