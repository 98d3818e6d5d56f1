"""Images of several cameras: each is a step and a stream of its own."""

from dataclasses import replace

import numpy as np

from fbench.metrics.files.side import Side, has_solids
from fbench.metrics.objects import Objects
from fbench.metrics.sequence import Steps
from fbench.replay.arrays import Int64, Text
from fbench.replay.errors import LogError


def by_camera(steps: Steps, truth: Side, estimates: Side, where: tuple[str, str]) -> tuple[Steps, Objects, Objects]:
    """Return steps and the objects of both sides, parted by camera where there are several and boxes are in images.

    Where both sides have solids, these are what is scored, and cameras don't matter: rectangles are left out.

    Raises:
        LogError: where the camera of a rectangle isn't told, though there are several.
    """
    cameras = _names(truth, estimates)
    if len(cameras) < 2:
        return steps, truth.objects, estimates.objects
    if has_solids(truth.objects) and has_solids(estimates.objects):
        return steps, replace(truth.objects, xyxy_px=None), replace(estimates.objects, xyxy_px=None)
    num = len(cameras)
    parted = Steps(
        np.repeat(steps.frame, num),
        np.repeat(steps.stamp_ns, num),
        np.tile(np.arange(num), len(steps)),
        tuple(cameras.tolist()) * len(steps),
    )
    return parted, _parted(truth, cameras, where[0]), _parted(estimates, cameras, where[1])


def _names(*sides: Side) -> Text:
    found: Text = np.unique(np.concatenate([side.camera for side in sides]))
    named: Text = found[found != ""]
    return named


def _parted(side: Side, cameras: Text, where: str) -> Objects:
    if not len(side.objects):
        return side.objects
    there_are = f"there are the cameras {', '.join(cameras.tolist())}; tell that of every box in a column 'camera'"
    if not len(side.camera) or side.objects.xyxy_px is None:
        raise LogError(f"{where}: {there_are}")
    there = np.flatnonzero(~np.isnan(side.objects.xyxy_px).all(axis=1))
    if (side.camera[there] == "").any():
        raise LogError(f"{where}: a box without camera, though {there_are}")
    objects, number = side.objects[there], np.searchsorted(cameras, side.camera[there])
    step: Int64 = objects.step * len(cameras) + number
    order = np.argsort(step, kind="stable")
    return replace(objects[order], step=step[order])
