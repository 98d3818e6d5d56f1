"""Drawing into pictures (H, W, 3), BGR; they are changed in place."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from fbench.replay.data.arrays import Array, Float64
from fbench.replay.data.images import Pixels

Color: TypeAlias = tuple[int, int, int]
Colors: TypeAlias = NDArray[np.uint8]

BACKGROUND: Color = (20, 16, 13)
PANEL: Color = (42, 36, 32)
GRID: Color = (66, 58, 52)
INK: Color = (240, 236, 232)
QUIET: Color = (176, 168, 160)
TRUTH: Color = (90, 255, 90)
TRUTH_2D: Color = (255, 230, 60)
CURVE: Color = (60, 210, 255)
MAX_DISKS = 100_000  # Drawn one by one in a picture; of more, every n-th is
OUTLINE = [0, 1, 2, 1, 2, 3, 0, 3, 0, 1]  # Of a rectangle (left, top, right, bottom): a closed line of five points
NEAR_M, FAR_M = 2.0, 80.0
MAX_SPEED_MPS = 10.0
_FARTHEST_PX = 16_000  # From the picture's corner, which OpenCV takes
_FONT, _SCALE = 0, 0.42
_CYCLE: tuple[Color, ...] = (
    (235, 206, 135), (80, 175, 250), (140, 220, 120), (220, 130, 230), (90, 235, 235), (150, 150, 250), (230, 170, 90),
    (190, 220, 190), (120, 120, 220), (210, 210, 90), (170, 110, 250), (110, 190, 170),
)  # fmt: skip


def of_sensor(index: int) -> Color:
    """Color of the sensor with this number in the order of names."""
    return _CYCLE[index % len(_CYCLE)]


def of_depth(depth_m: Float64) -> Colors:
    """Colors (N, 3) of depths (N,) [m], by their logarithm: red at 2 m, over green, to blue from 80 m on."""
    import cv2

    if not len(depth_m):
        return np.zeros((0, 3), np.uint8)
    safe = np.clip(np.nan_to_num(depth_m, nan=FAR_M), NEAR_M, FAR_M)
    share = np.log(safe / NEAR_M) / np.log(FAR_M / NEAR_M)
    levels = np.round(235 - 215 * share).astype(np.uint8).reshape(-1, 1)
    return np.asarray(cv2.applyColorMap(levels, cv2.COLORMAP_TURBO), np.uint8).reshape(-1, 3)


def of_height(z_m: Float64, low_m: float, high_m: float) -> Colors:
    """Colors (N, 3) of heights (N,) [m]: blue at `low_m` and below, over green, to red from `high_m` on."""
    import cv2

    if not len(z_m):
        return np.zeros((0, 3), np.uint8)
    levels = np.round(20 + 215 * np.clip((z_m - low_m) / (high_m - low_m), 0, 1)).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels.reshape(-1, 1), cv2.COLORMAP_TURBO), np.uint8).reshape(-1, 3)


def of_speed(speed_mps: Float64) -> Colors:
    """Colors (N, 3) of radial velocities (N,) [m/s]: white where equal, red receding and blue approaching, full from
    10 m/s on (thesis); gray where it isn't measured.
    """
    share = np.clip(np.nan_to_num(speed_mps) / MAX_SPEED_MPS, -1, 1)
    fade = np.round(255 * (1 - np.abs(share)))
    full = np.full_like(fade, 255)
    colors = np.stack([np.where(share > 0, fade, full), fade, np.where(share < 0, fade, full)], axis=1)
    colors[np.isnan(speed_mps)] = 150
    return colors.astype(np.uint8)


def canvas(width: int, height: int) -> Pixels:
    """Return an empty picture."""
    return np.full((height, width, 3), BACKGROUND, np.uint8)


def plain(name: str, length: int = 36) -> str:
    """A name as pictures can show it: printable ASCII, not too long."""
    text = "".join(c if " " <= c <= "~" else "?" for c in name)
    return text if len(text) <= length else f"{text[: length - 3]}..."


def text_size(text: str, scale: float = _SCALE) -> tuple[int, int]:
    """Width and height [px] of a line of text."""
    import cv2

    (width, height), _ = cv2.getTextSize(text, _FONT, scale, 1)
    return int(width), int(height)


def write(picture: Pixels, text: str, at: tuple[float, float], color: Color = INK, boxed: bool = False) -> None:
    """Write a line with its left end of the base line `at`, on a dark ground where `boxed`."""
    import cv2

    x, y = _place(at)
    if boxed:
        width, height = text_size(text)
        cv2.rectangle(picture, (x - 4, y - height - 5), (x + width + 4, y + 5), PANEL, -1)
    cv2.putText(picture, text, (x, y), _FONT, _SCALE, color, 1, cv2.LINE_AA)


def lines(picture: Pixels, texts: Sequence[str], colors: Sequence[Color], at: tuple[int, int] = (10, 20)) -> None:
    """Write lines below each other on a dark ground, each with its color."""
    import cv2

    if not texts:
        return
    width = max(text_size(text)[0] for text in texts)
    x, y = at
    cv2.rectangle(picture, (x - 6, y - 15), (x + width + 6, y + 18 * len(texts) - 11), PANEL, -1)
    for row, (text, color) in enumerate(zip(texts, colors, strict=True)):
        write(picture, text, (x, y + 18 * row), color)


def disks(picture: Pixels, uv: Float64, radii: Array, colors: Colors, rim: bool = False) -> None:
    """Draw points (N, 2) [px] as disks, in their order, at most `MAX_DISKS` larger than a pixel; with a dark `rim` they
    are seen on a bright ground.
    """
    import cv2

    height, width = picture.shape[:2]
    inside = (uv[:, 0] >= -0.5) & (uv[:, 0] < width - 0.5) & (uv[:, 1] >= -0.5) & (uv[:, 1] < height - 0.5)
    if not rim and len(radii) and float(radii.max()) <= 1:
        at, colors = np.round(uv[inside]).astype(np.int64), colors[inside]
        for du, dv in ((0, -1), (-1, 0), (1, 0), (0, 1), (0, 0)):  # many: five pixels each, their middles last
            u, v = at[:, 0] + du, at[:, 1] + dv
            there = (u >= 0) & (u < width) & (v >= 0) & (v < height)
            picture[v[there], u[there]] = colors[there]
        return
    shown = np.flatnonzero(inside)
    shown = shown[:: max(1, -(-len(shown) // MAX_DISKS))]
    places = np.round(uv[shown]).astype(int).tolist()
    for place, radius, color in zip(places, radii[shown].tolist(), colors[shown].tolist(), strict=True):
        if rim:
            cv2.circle(picture, place, int(radius) + 1, (0, 0, 0), -1, cv2.LINE_AA)
        cv2.circle(picture, place, int(radius), color, -1, cv2.LINE_AA if rim else cv2.LINE_8)


def path(picture: Pixels, uv: Float64, color: Color, thickness: int = 1, rim: bool = False) -> None:
    """Join points (N, 2) [px] by lines; it is broken where one isn't finite."""
    import cv2

    is_finite = np.asarray(np.isfinite(uv).all(axis=1), np.bool_)
    places = np.clip(np.round(np.where(np.isfinite(uv), uv, 0)), -_FARTHEST_PX, _FARTHEST_PX).astype(int).tolist()
    for wide, ink in ((thickness + 2, (0, 0, 0)), (thickness, color)) if rim else ((thickness, color),):
        for i in np.flatnonzero(is_finite[:-1] & is_finite[1:]).tolist():
            cv2.line(picture, places[i], places[i + 1], ink, wide, cv2.LINE_AA)


def color_bar(picture: Pixels, colors: Colors, labels: Sequence[tuple[float, str]], title: str) -> None:
    """Draw a bar of colors into the lower right corner; labels stand at shares 0 to 1 of its width."""
    import cv2

    height, width = picture.shape[:2]
    bar_width = min(240, width // 3)
    left, top = width - bar_width - 22, height - 34
    cv2.rectangle(picture, (left - 12, top - 20), (width - 6, height - 4), PANEL, -1)
    bar = cv2.resize(colors.reshape(1, -1, 3), (bar_width, 9), interpolation=cv2.INTER_NEAREST)
    picture[top : top + 9, left : left + bar_width] = bar
    write(picture, title, (left, top - 6))
    for share, label in labels:
        x = left + share * bar_width - text_size(label)[0] / 2
        write(picture, label, (min(max(x, left - 8), width - 10 - text_size(label)[0]), top + 24))


def _place(at: Sequence[float] | Array) -> tuple[int, int]:
    """Round to what OpenCV takes, far outside stays outside."""
    x, y = (min(max(round(float(value)), -_FARTHEST_PX), _FARTHEST_PX) for value in (at[0], at[1]))
    return x, y
