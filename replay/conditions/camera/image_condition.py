"""Conditions of cameras: pixels in, pixels out."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import wraps
from typing import ClassVar, TypeVar

from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.arrays import Float32
from fbench.replay.data.images import Pixels, decode
from fbench.replay.data.messages import Image
from fbench.replay.data.rig import Kind

C = TypeVar("C")


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
    """What conditions of cameras have in common."""

    version: ClassVar[int] = 1
    kinds: ClassVar[Sequence[Kind]] = ("camera",)


def for_images(
    edit: Callable[[C, Pixels, Level, Image, Site], Pixels],
) -> Callable[[C, Measurement, Level, Site], Sequence[Measurement]]:
    """Make `Condition.disturb` of a method that gives a new image (H, W, 3), BGR, or the same, for pixels of an image;
    what can't be decoded stays.
    """

    @wraps(edit)
    def disturb(condition: C, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        if not isinstance(message, Image):
            return (message,)
        return (edit_image(message, lambda pixels: edit(condition, pixels, level, message, site)),)

    return disturb
