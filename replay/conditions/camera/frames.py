"""Cameras that fail: black for the whole log or for single frames, or frozen."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from fbench.replay.conditions.camera.image_condition import ImageCondition, for_images
from fbench.replay.contracts.conditions import Level, Measurement, Site
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Image

_BURST = 4  # Frames


class CameraCrash(ImageCondition):
    """Some of the log's cameras are black all the time: the whole number nearest to a share of them, at least one.
    They are drawn without replacement among all cameras, whichever of them the condition is for.

    Levels of RoboBEV (Xie et al. 2023), whose draw gives some cameras twice.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"crashed_share": (1 / 6, 2 / 6, 3 / 6, 4 / 6, 5 / 6)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Return black where this camera is drawn."""
        cameras = site.rig.sensors("camera")
        num = min(len(cameras), max(1, int(level["crashed_share"] * len(cameras) + 0.5)))
        crashed = site.rng_of_log("crash").permutation(len(cameras))[:num]
        return np.zeros_like(pixels) if cameras.index(site.sensor) in crashed else pixels


class LostFrames(ImageCondition):
    """Each frame is black with a probability, whatever became of others.

    Levels of RoboBEV's `FrameLost` (Xie et al. 2023): s / 6.
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"lost_share": (0.17, 0.33, 0.5, 0.67, 0.83)}

    @for_images
    def disturb(self, pixels: Pixels, level: Level, image: Image, site: Site) -> Pixels:
        """Return black, or the image."""
        return np.zeros_like(pixels) if site.rng_of(image).random() < level["lost_share"] else pixels


class FrozenFrames(ImageCondition):
    """The picture stands still while stamps go on: time is cut into bursts of four frames, of which a share repeats the
    frame before the burst. Never across a gap of two bursts, nor a change of the rig. It repeats frames as recorded,
    so name it before conditions that act on their pixels.

    Levels and length as in the benchmark of Yu et al. (2023).
    """

    levels: ClassVar[Mapping[str, Sequence[float]]] = {"frozen_share": (0.1, 0.3, 0.5, 0.7, 0.9)}

    def disturb(self, message: Measurement, level: Level, site: Site) -> Sequence[Measurement]:
        """Return the frame before the burst with the stamps of this one, or the frame."""
        length_ns = _BURST * site.period_ns
        burst, after_ns = divmod(message.stamp_ns - site.first_ns, length_ns)
        before = [m for m in site.history if 0 < message.stamp_ns - after_ns - m.stamp_ns < 2 * length_ns]
        is_frozen = site.rng("burst", burst).random() < level["frozen_share"]
        old = max(before, key=lambda m: m.stamp_ns, default=None)
        if not is_frozen or not isinstance(message, Image) or not isinstance(old, Image):
            return (message,)
        return (replace(message, data=old.data, encoding=old.encoding, size_wh=old.size_wh, video=old.video),)
