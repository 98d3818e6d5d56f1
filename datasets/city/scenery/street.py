"""Objects in streets: lamp posts, benches, bins, hydrants and traffic signals."""

import numpy as np

from fbench.datasets.city.mesh import Mesh, Rgb, Skin, Three, box, cylinder, loft, merged

_STEEL = Skin("pole", (0.19, 0.2, 0.205))
_DARK = Skin("pole", (0.04, 0.045, 0.045))
_BULB = Skin("street_lamp", (1.0, 0.86, 0.65))


def lamp_post(size_lwh_m: Three) -> Mesh:
    """Return a post whose arm reaches `length` to the front from its foot."""
    reach, width, height = size_lwh_m
    base = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.9), min(0.11, width / 2), 8, _STEEL)
    pole = cylinder((0.0, 0.0, 0.0), (0.0, 0.0, height - 0.5), 0.085, 8, _STEEL, 0.055)
    bend = [(0.0, -0.55), (0.04, -0.35), (0.16, -0.18), (0.4, -0.08), (reach - 0.55, -0.06)]
    arm = loft([_ring(x, height + z, slope) for (x, z), slope in zip(bend, (0.0, 0.3, 0.8, 1.3, 1.57), strict=True)],
               _STEEL)  # fmt: skip
    middle = reach - 0.35
    head = box((middle, 0.0, height - 0.05), (0.7, min(0.26, width), 0.1), _STEEL)
    glass = box((middle + 0.03, 0.0, height - 0.115), (0.5, 0.7 * min(0.26, width), 0.03), _BULB)
    return merged([base, pole, arm, head, glass])


def bench(size_lwh_m: Three) -> Mesh:
    """Return a bench of wooden slats on two iron feet; one sits looking towards x."""
    length, width, height = size_lwh_m
    wood, seat = Skin("wood", (0.2, 0.11, 0.055)), 0.53 * height
    deep = length / 3
    parts = [box((x, 0.0, seat - 0.02), (deep * 0.75, width, 0.04), wood) for x in (-deep / 2, deep / 2, deep * 1.12)]
    parts += [box((-length / 2 + 0.03, 0.0, height * z), (0.04, width, 0.13 * height), wood) for z in (0.72, 0.93)]
    for y in (-0.38 * width, 0.38 * width):
        parts += [
            box((0.0, y, seat - 0.07), (0.9 * length, 0.05, 0.06), _DARK),
            box((0.38 * length, y, seat / 2 - 0.05), (0.05, 0.05, seat - 0.1), _DARK),
            box((-0.38 * length, y, seat / 2 - 0.05), (0.05, 0.05, seat - 0.1), _DARK),
            box((-length / 2 + 0.075, y, 0.75 * height), (0.05, 0.05, 0.48 * height), _DARK),
        ]
    return merged(parts)


def bin_(size_lwh_m: Three, rng: np.random.Generator) -> Mesh:
    """Return a litter bin with a slanted lid."""
    length, width, height = size_lwh_m
    radius = min(length, width) / 2
    color = ((0.03, 0.09, 0.05), (0.05, 0.05, 0.055), (0.35, 0.13, 0.02))[int(rng.integers(3))]
    return merged([
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.78 * height), 0.85 * radius, 10, Skin("plastic", color), 0.97 * radius),
        cylinder((0.0, 0.0, 0.78 * height), (0.0, 0.0, 0.9 * height), 0.8 * radius, 10, Skin("plastic", (0.01,) * 3)),
        cylinder((0.0, 0.0, 0.9 * height), (0.0, 0.0, height), radius, 10, Skin("plastic", color), 0.6 * radius),
    ])  # fmt: skip


def hydrant(size_lwh_m: Three) -> Mesh:
    """Return a red hydrant with three caps."""
    length, width, height = size_lwh_m
    red = Skin("paint", (0.42, 0.03, 0.025))
    r = 0.32 * min(length, width)
    z = 0.62 * height
    return merged([
        cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 0.06), 1.35 * r, 10, red),
        cylinder((0.0, 0.0, 0.05), (0.0, 0.0, 0.8 * height), r, 10, red),
        cylinder((0.0, 0.0, 0.8 * height), (0.0, 0.0, height), 1.2 * r, 10, red, 0.3 * r),
        cylinder((0.0, -width / 2, z), (0.0, width / 2, z), 0.55 * r, 8, Skin("metal", (0.4, 0.4, 0.38))),
        cylinder((0.0, 0.0, z), (length / 2, 0.0, z), 0.7 * r, 8, red),
    ])  # fmt: skip


def _ring(x: float, z: float, slope: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Six points about a tube at x, z that leans forward by `slope` radians from upright."""
    angle = np.arange(6) * (np.pi / 3)
    across = 0.045 * np.cos(angle)
    return np.column_stack([x + across * np.cos(slope), 0.045 * np.sin(angle), z - across * np.sin(slope)])


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
