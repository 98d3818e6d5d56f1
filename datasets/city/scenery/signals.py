"""Traffic signals: heads of two or three lamps on a post."""

from fbench.datasets.city.mesh import Mesh, merged
from fbench.datasets.city.shapes import Rgb, Skin, Three, box, cylinder

LAMPS: tuple[Rgb, Rgb, Rgb] = ((1.0, 0.035, 0.02), (1.0, 0.5, 0.02), (0.03, 1.0, 0.42))
"""Red, yellow, green: the order of lamps in a group."""
_POST = Skin("pole", (0.17, 0.18, 0.18))
_CASE = Skin("plastic", (0.018, 0.018, 0.018))


def signal(size_lwh_m: Three) -> Mesh:
    """Return a signal for those who come towards its front (x); its lamps are numbered 0 red, 1 yellow, 2 green.

    Below 3 m it is one for pedestrians, without yellow.
    """
    length, width, height = size_lwh_m
    deep = min(length, 0.5)
    post = -deep / 2 + 0.045
    lamps = (0, 1, 2) if height >= 3.0 else (0, 2)
    top = height - 0.16 * len(lamps) - 0.02
    return merged([
        cylinder((post, 0.0, 0.0), (post, 0.0, height), 0.045, 8, _POST),
        *_head((post + 0.04, 0.0, top), deep / 2, min(width, 0.32), lamps),
    ])  # fmt: skip


def _head(back_m: Three, front_m: float, width_m: float, lamps: tuple[int, ...]) -> list[Mesh]:
    """A black case with its lamps, one above the other: its back's middle, and how far the visors reach."""
    x, y, z = back_m
    deep = 0.4 * (front_m - x)
    parts = [box((x + deep / 2, y, z), (deep, width_m, 0.32 * len(lamps)), _CASE)]
    for place, number in enumerate(lamps):
        level = z + 0.31 * ((len(lamps) - 1) / 2 - place)
        lamp = cylinder((x + deep - 0.01, y, level), (x + deep + 0.01, y, level), 0.36 * width_m, 10,
                        Skin("signal_lamp", LAMPS[number], number))  # fmt: skip
        out = front_m - x - deep
        visor = box((x + deep + out / 2, y, level + 0.39 * width_m), (out, 0.7 * width_m, 0.012), _CASE)
        parts += [lamp, visor]
    return parts
