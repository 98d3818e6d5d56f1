"""Image and CompressedImage, read without rosbags so that their bytes are copied once, and CameraInfo."""

from typing import Any, NamedTuple

import numpy as np

from fbench.replay.contracts.errors import DecodeError, DepthError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import DEPTH, MAX_PIXELS, is_picture, layout_name, pack_rows, read_size, sniff_format
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import CameraModel
from fbench.replay.logs.codecs.codec import Origin, Probe
from fbench.replay.logs.codecs.ros.cursor import Cursor, Header
from fbench.replay.logs.codecs.ros.decoder import get, header
from fbench.replay.logs.codecs.video.stream import find_codec, peek_size


class RawImage(NamedTuple):
    """`sensor_msgs/Image`."""

    header: Header
    height: int
    width: int
    encoding: str
    is_bigendian: bool
    step: int
    data: memoryview  # View of the payload


class CompressedImage(NamedTuple):
    """`sensor_msgs/CompressedImage`."""

    header: Header
    format: str
    data: memoryview  # View of the payload


def read_raw_image(data: memoryview, encoding: str) -> RawImage:
    """Read an Image. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    head, height, width, layout = cursor.header(), cursor.uint32(), cursor.uint32(), cursor.string()
    is_bigendian, step, pixels = bool(cursor.uint8()), cursor.uint32(), cursor.blob()
    cursor.end()
    return RawImage(head, height, width, layout, is_bigendian, step, pixels)


def read_compressed_image(data: memoryview, encoding: str) -> CompressedImage:
    """Read a CompressedImage. Raises DecodeError where the payload is damaged."""
    cursor = Cursor(data, encoding)
    image = CompressedImage(cursor.header(), cursor.string(), cursor.blob())
    cursor.end()
    return image


def probe_image(image: RawImage | CompressedImage, encoding: str) -> Probe:
    """Tell the coordinate frame. Raises DecodeError where the layout isn't known, or it is depth: no picture."""
    if isinstance(image, RawImage):
        layout_name(image.encoding)
    elif "compressedDepth" in image.format or image.format.startswith(DEPTH):
        raise DepthError(f"format '{image.format}' is a depth image, not supported")
    return Probe("camera", image.header.frame_id)


def raw_image(kind: str, image: RawImage, encoding: str, origin: Origin) -> Image:
    """Return a raw image, packed, 16 bits little-endian. Raises DecodeError where layout, size or data don't fit."""
    name, size_wh = layout_name(image.encoding), (image.width, image.height)
    if image.width * image.height > MAX_PIXELS:
        raise DecodeError(f"image of {image.width}x{image.height} px is larger than {MAX_PIXELS} px")
    pixels = pack_rows(image.data, name, size_wh, image.step, is_bigendian=image.is_bigendian)
    return Image(origin.sensor, image.header.stamp_ns, origin.log_ns, pixels, name, size_wh, origin.frame_number)


def decode_compressed_image(kind: str, image: CompressedImage, encoding: str, origin: Origin) -> Image:
    """Return a compressed image; its first bytes tell what it is, because writers name formats in many ways, unless it
    is a picture of a video, which encoders such as those of Isaac ROS send so. Raises DecodeError where it is a depth
    image, or neither JPEG nor PNG nor WebP, or its header is damaged.
    """
    probe_image(image, encoding)
    data, stamp_ns = bytes(image.data), image.header.stamp_ns
    if (codec := find_codec(image.format)) and not is_picture(data):
        name, size_wh = codec, peek_size(codec, data)
    else:
        name, size_wh = sniff_format(data), read_size(data)
    return Image(origin.sensor, stamp_ns, origin.log_ns, data, name, size_wh, origin.frame_number)


_MODELS = {"equidistant": "fisheye", "kannala_brandt": "fisheye"}
"""What fbench calls a distortion model that ROS calls otherwise."""


def camera_model(info: Any, encoding: str) -> tuple[str, CameraModel]:
    """Return coordinate frame and intrinsics of the images published with a CameraInfo: binning and region are applied.
    A pixel of b x b binned ones has its center at b u + (b - 1) / 2, so c' = (c - offset + 0.5) / b - 0.5. Raises
    DecodeError where the camera isn't calibrated, or the numbers can't be those of a camera.
    """
    frame_id = header(info, encoding).frame_id
    K = np.array(get(info, "k", "K"), np.float64).reshape(3, 3)
    distortion = np.array(get(info, "d", "D"), np.float64).reshape(-1)
    if not K.any():
        raise DecodeError(f"camera '{frame_id}' isn't calibrated (K is zero)")
    if not CameraModel(K, (1, 1), "", distortion).is_sound:
        raise DecodeError(f"camera '{frame_id}' has no valid focal length, center and distortion")
    model = str(get(info, "distortion_model"))
    size_wh = _apply_region(info, K, frame_id)
    return frame_id, CameraModel(K, size_wh, _MODELS.get(model, model), distortion)


def _apply_region(info: Any, K: Float64, frame_id: str) -> tuple[int, int]:
    """Change `K` to that of the region, then of the binned image; return the size of the image."""
    roi, full = get(info, "roi"), (int(get(info, "width")), int(get(info, "height")))
    offset = (int(get(roi, "x_offset")), int(get(roi, "y_offset")))
    region = (int(get(roi, "width")) or full[0], int(get(roi, "height")) or full[1])
    binning = (max(1, int(get(info, "binning_x"))), max(1, int(get(info, "binning_y"))))
    if any(o + r > f for o, r, f in zip(offset, region, full, strict=True)):
        what = f"a region of {region} at {offset} outside its {full[0]}x{full[1]} px"
        raise DecodeError(f"camera '{frame_id}' has {what}")
    for axis in range(2):
        if offset[axis] or binning[axis] > 1:
            K[axis, 2] = (K[axis, 2] - offset[axis] + 0.5) / binning[axis] - 0.5
            K[axis, :2] /= binning[axis]
    width, height = region[0] // binning[0], region[1] // binning[1]
    if not (width and height):
        raise DecodeError(f"camera '{frame_id}' has an image size of {width}x{height}")
    return width, height
