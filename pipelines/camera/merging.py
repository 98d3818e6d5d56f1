"""Cutting a wide image into overlapping windows, and merging what was found in them."""

import math

import numpy as np

from fbench.pipelines.camera.candidates import Candidates, join
from fbench.pipelines.camera.layouts import Size
from fbench.replay.arrays import Float64
from fbench.replay.data import VEHICLES
from fbench.replay.geometry.boxes import iou_2d

Window = tuple[int, int, int, int]
"""Left, top, right, bottom [px] of a part of an image; right and bottom are outside."""

MAX_WINDOWS = 8
"""A longer image is cut into windows that are wider instead, so that a strip can't fill the memory."""

MAX_BOXES = 1000
"""Candidates beyond the best 1000 of one image are dropped, so that a bad model can't fill the memory."""


def windows(size_wh: Size, aspect: float, overlap: float) -> list[Window]:
    """The whole image, and, where its longer side exceeds `aspect` times the shorter one, windows of that aspect.

    Windows lie along the longer side, evenly spread; neighbours overlap by at least the share `overlap`. They are
    longer than `aspect` says where more than `MAX_WINDOWS` were needed otherwise.
    """
    width, height = size_wh
    short, length = min(size_wh), max(size_wh)
    whole = [(0, 0, width, height)]
    longest = math.ceil(length / (1 + (MAX_WINDOWS - 1) * (1 - overlap)))
    side = round(min(length, max(short * aspect, longest)))
    if side == length:
        return whole
    num = min(MAX_WINDOWS, 1 + math.ceil((length - side) / (side * (1 - overlap))))
    starts = [round((length - side) * i / (num - 1)) for i in range(num)]
    if width > height:
        return whole + [(at, 0, at + side, short) for at in starts]
    return whole + [(0, at, short, at + side) for at in starts]


def to_image(boxes: Candidates, window: Window, size_wh: Size, margin_px: float = 3.0) -> Candidates:
    """Move boxes from a window to the image, without those that the window's inner border cuts.

    A cut box is only a part of an object, which a neighbouring window or the whole image shows in full.
    """
    left, top, right, bottom = window
    inner = np.array([left > 0, top > 0, right < size_wh[0], bottom < size_wh[1]])
    clipped = boxes.clipped((right - left, bottom - top))
    gap = np.abs(clipped.xyxy - np.array([0.0, 0.0, right - left, bottom - top]))
    whole = ~((gap < margin_px) & inner).any(axis=1)
    return clipped.rows(whole).moved((1.0, 1.0), (float(left), float(top)))


def merge(parts: list[Candidates], iou: float, containment: float) -> Candidates:
    """Greedy non-maximum suppression: of two rivals of one group the one with the better score stays.

    Rivals overlap by more than `iou`, or one contains more than the share `containment` of the other, which then
    is a part of the same object.

    All vehicles are one group, since one object can come back as bus and as truck; others are groups by label.
    """
    boxes = join(parts).ordered()
    boxes = boxes.rows(np.arange(min(len(boxes), MAX_BOXES)))
    group = np.where(np.isin(boxes.label, VEHICLES), "vehicle", boxes.label)
    rivals = (iou_2d(boxes.xyxy, boxes.xyxy) > iou) | (_containment(boxes.xyxy) > containment)
    rivals &= group[:, None] == group[None, :]
    alive = np.ones(len(boxes), bool)
    for i in range(len(boxes)):
        if alive[i]:
            alive[i + 1 :] &= ~rivals[i, i + 1 :]
    return boxes.rows(alive)


def _containment(xyxy: Float64) -> Float64:
    """Intersection of each two boxes by the area of the smaller one (N, N)."""
    low = np.maximum(xyxy[:, None, :2], xyxy[None, :, :2])
    high = np.minimum(xyxy[:, None, 2:], xyxy[None, :, 2:])
    overlap = np.prod(np.clip(high - low, 0, None), axis=2)
    area = np.prod(xyxy[:, 2:] - xyxy[:, :2], axis=1)
    share: Float64 = overlap / np.minimum(area[:, None], area[None, :])
    return share
