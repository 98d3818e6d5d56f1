"""Image and CompressedImage as camera images, still encoded as they were recorded."""

from fbench.replay.data import Image
from fbench.replay.errors import DecodeError, UnsupportedError
from fbench.replay.images import MAX_PIXELS, encoded_format, encoded_size
from fbench.replay.logs.codec import Origin
from fbench.replay.logs.ros.sensor_messages import CompressedImage, RawImage
from fbench.replay.raw_images import layout_name, packed


def check_format(image: CompressedImage) -> None:
    """Refuse depth images, whose PNG isn't a picture.

    Raises:
        DecodeError: where it is one.
    """
    if "compressedDepth" in image.format:
        raise UnsupportedError(f"format '{image.format}' is a depth image, not supported")


def raw(image: RawImage, stamp_ns: int, origin: Origin) -> Image:
    """Return a raw image, its rows packed and 16 bits little-endian.

    Raises:
        DecodeError: where the layout isn't known, or size and data don't fit together.
    """
    name, size_wh = layout_name(image.encoding), (image.width, image.height)
    if image.width * image.height > MAX_PIXELS:
        raise DecodeError(f"image of {image.width}x{image.height} px is larger than {MAX_PIXELS} px")
    pixels = packed(image.data, name, size_wh, image.step, is_bigendian=image.is_bigendian)
    return Image(origin.sensor, stamp_ns, origin.log_ns, pixels, name, size_wh, origin.frame_number)


def compressed(image: CompressedImage, stamp_ns: int, origin: Origin) -> Image:
    """Return a compressed image; its first bytes tell what it is, because writers name formats in many ways.

    Raises:
        DecodeError: where it is a depth image, or neither JPEG nor PNG nor WebP, or its header is damaged.
    """
    check_format(image)
    encoding = encoded_format(image.data)
    data = bytes(image.data)
    size_wh = encoded_size(data)
    return Image(origin.sensor, stamp_ns, origin.log_ns, data, encoding, size_wh, origin.frame_number)
