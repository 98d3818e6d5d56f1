"""How much conditions changed, for the manifest and the report."""

from collections.abc import Mapping, Sequence

import numpy as np

from fbench.replay.contracts.conditions import Measurement
from fbench.replay.data.arrays import Bool
from fbench.replay.data.images import decode
from fbench.replay.data.messages import Image, PointCloud, RadarScan
from fbench.replay.data.rig import Rig

_EVERY = 16  # Of the rows and columns of an image, for the mean difference
_WORDS = {"dropped": "lost", "added": "repeated", "late": "late", "restamped": "restamped"}
_VALUES = ("intensity", "radial_velocity_mps", "rcs_dbsm")


class Effects:
    """Counts by sensor: what came and went, and the size of the change; the order of messages doesn't matter but for
    the last digits, which aren't kept.
    """

    def __init__(self) -> None:
        self._sums: dict[str, dict[str, float]] = {}

    def add(self, recorded: Measurement, results: Sequence[Measurement], raw: Measurement | None = None) -> None:
        """Count what became of one message; `raw` is the same, where it is an image that was decoded already."""
        self.count(recorded.sensor, self.measure(recorded, results, raw))

    def measure(
        self, recorded: Measurement, results: Sequence[Measurement], raw: Measurement | None = None
    ) -> dict[str, float]:
        """Return the numbers of what became of one message, without adding them."""
        flags: dict[str, int | bool] = {
            "messages": 1, "dropped": not results, "added": max(0, len(results) - 1),
            "changed": [*results] != [recorded],
            "late": any(result.log_ns > recorded.log_ns for result in results),
            "restamped": any(result.stamp_ns != recorded.stamp_ns for result in results),
        }  # fmt: skip
        counts: dict[str, float] = {name: int(value) for name, value in flags.items()}
        if results:
            after = results[0]
            counts |= compare(recorded if after is recorded or raw is None else raw, after)
        return counts

    def count(self, sensor: str, counts: Mapping[str, float]) -> None:
        """Add the numbers of one message of a sensor."""
        own = self._sums.setdefault(sensor, {})
        for name, value in counts.items():
            own[name] = own.get(name, 0) + value

    def add_rig(self, recorded: Rig, given: Rig) -> None:
        """Note how far the calibration that a pipeline is given is from the recorded one; the largest counts."""
        for sensor in given.list_changes(recorded):
            own = self._sums.setdefault(sensor, {})
            for name, value in _compare_calibration(recorded, given, sensor).items():
                own[name] = max(own.get(name, 0.0), value)

    def rows(self) -> dict[str, dict[str, float]]:
        """Return sums by sensor; those of real numbers rounded to 6 digits."""
        return {
            sensor: {name: value if isinstance(value, int) else float(f"{value:.6g}") for name, value in sums.items()}
            for sensor, sums in sorted(self._sums.items())
        }


def describe(row: Mapping[str, float]) -> str:
    """Say in one line what conditions changed of a sensor, from its sums."""
    num, changed, points = (int(row.get(name, 0)) for name in ("messages", "changed", "points_before"))
    texts = [f"{changed} of {num} messages changed"] if changed else []
    texts += ["as recorded, since the pipeline doesn't use it"] if row.get("unused") else []
    for name in ("dropped", "added", "late", "restamped"):
        texts += [f"{int(row[name])} {_WORDS[name]}"] if row.get(name) else []
    if points and row["points_after"] != points:
        texts.append(f"{100 * (row['points_after'] / points - 1):+.1f} % points")
    if moved := row.get("points_moved"):
        texts.append(f"{int(moved)} points moved by {row['moved_m'] / moved:.3g} m on average")
    if revalued := row.get("points_revalued"):
        texts.append(f"{int(revalued)} points with other values")
    if changed and row.get("gray_levels"):
        texts.append(f"pixels {row['gray_levels'] / changed:.3g} gray levels off on average")
    if row.get("mount_deg") or row.get("mount_m"):
        texts.append(f"mount {row['mount_deg']:.3g}° and {row['mount_m']:.3g} m off")
    if row.get("focal_px") or row.get("center_px"):
        texts.append(f"focal length {row['focal_px']:.3g} px and center {row['center_px']:.3g} px off")
    return ", ".join(texts) or "nothing changed"


def compare(before: Measurement, after: Measurement) -> Mapping[str, float]:
    """Points that came, went, moved [m, summed] and have other values, or the mean difference of gray levels."""
    if isinstance(before, Image) or isinstance(after, Image):
        return {"gray_levels": _difference(before, after)}
    counts: dict[str, float] = {"points_before": len(before.xyz), "points_after": len(after.xyz)}
    if len(before.xyz) == len(after.xyz):
        distance = np.sqrt(((before.xyz.astype(np.float64) - after.xyz) ** 2).sum(axis=1))
        counts |= {"points_moved": int(np.count_nonzero(distance > 0)), "moved_m": float(np.nansum(distance))}
        counts |= {"points_revalued": int(np.count_nonzero(_other_values(before, after)))}
    return counts


def _difference(before: Measurement, after: Measurement) -> float:
    if not (isinstance(before, Image) and isinstance(after, Image)) or before.data is after.data:
        return 0.0
    old, new = decode(before), decode(after)
    if old is None or new is None or old.shape != new.shape:
        return 0.0
    return float(np.abs(old[::_EVERY, ::_EVERY].astype(np.int16) - new[::_EVERY, ::_EVERY]).mean())


def _other_values(before: PointCloud | RadarScan, after: PointCloud | RadarScan) -> Bool:
    differ = np.zeros(len(before.xyz), bool)
    for name in _VALUES:
        old, new = getattr(before, name, None), getattr(after, name, None)
        if old is not None and new is not None and old is not new:
            differ |= old != new
    return differ


def _compare_calibration(recorded: Rig, given: Rig, sensor: str) -> dict[str, float]:
    from scipy.spatial.transform import Rotation  # takes a while to import

    result = dict[str, float]()
    if sensor in recorded.mounts and not given.mounts[sensor].equals(recorded.mounts[sensor]):
        old, new = recorded.mounts[sensor], given.mounts[sensor]
        turn = Rotation.from_quat(old.rotation_xyzw).inv() * Rotation.from_quat(new.rotation_xyzw)
        shift = new.translation_m - old.translation_m
        result |= {"mount_deg": float(np.degrees(turn.magnitude())), "mount_m": float(np.sqrt((shift**2).sum()))}
    if sensor in recorded.cameras and not given.cameras[sensor].equals(recorded.cameras[sensor]):
        off = given.cameras[sensor].K - recorded.cameras[sensor].K
        result |= {
            "focal_px": float(np.abs(np.diag(off)[:2]).max()),
            "center_px": float(np.hypot(off[0, 2], off[1, 2])),
        }
    return result
