"""Base of camera conditions: pixels in, pixels out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.arrays import Float32
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import Kind


def edit_image(image: Image, edit: Callable[[Pixels], Pixels]) -> Image:
    """Return the image, raw BGR, after `edit` of its pixels (H, W, 3); itself where it can't be decoded, or `edit`
    gives back what it got.
    """
    pixels = decode(image)
    if pixels is None:
        return image
    edited = edit(pixels)
    return image if edited is pixels else replace(image, data=edited.tobytes(), encoding="bgr8", video=None)


def hide(pixels: Pixels, layer: Float32, bgr: tuple[float, float, float]) -> Pixels:
    """Return an image (H, W, 3) behind a layer of one color (0 to 255) with an opacity (H, W) of 0 to 1."""
    from fbench.replay.conditions.camera.kernels import cover  # numba takes a while to import

    return cover(pixels.reshape(-1), layer.reshape(-1), *bgr).reshape(pixels.shape)


class ImageCondition:
    """A condition of cameras, which implements `fbench.replay.contracts.conditions.Condition`."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("camera",)
    levels: ClassVar[Mapping[str, Sequence[float]]] = {}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return the message with its pixels edited."""
        if not isinstance(message, Image):
            return (message,)
        return (edit_image(message, lambda pixels: self.edit(pixels, level, message, site)),)

    def edit(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Return a new image (H, W, 3) of the pixels of `image`, BGR."""
        raise NotImplementedError
