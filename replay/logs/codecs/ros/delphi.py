"""Radars of Delphi in the messages of AutonomouStuff: a scan as one message, or each return as one of its own.

After delphi_esr_msgs and delphi_mrr_msgs: angles are in degrees and count to the right, range rates are positive when
receding. The tracks of an ESR are what it gives; it has no detections besides.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from fbench.replay.contracts.errors import DecodeError
from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.logs.codecs.codec import Assembler, Origin
from fbench.replay.logs.codecs.ros.decoder import find, get, header
from fbench.replay.logs.codecs.ros.radar_lists import Polar, polar_scan

_DEG = -np.pi / 180
_ESR = Polar("range", "angle", "range_rate", unit_rad=_DEG)
_MRR = Polar("range", "azimuth", "range_rate", "amplitude", unit_rad=_DEG)
_LAST = 64  # Numbers of returns go from 1 to this


def ethernet_scan(kind: str, message: Any, encoding: str, origin: Origin) -> RadarScan:
    """Read an EsrEthTx, the returns of which are in arrays."""
    num = int(get(message, "target_report_count"))
    names = ("range", "theta", "range_rate", "amplitude")
    columns = [np.array(get(message, f"target_report_{name}"), np.float64)[:num] for name in names]
    distance, angle, rate, strength = columns
    azimuth = angle * _DEG
    xyz = np.stack([distance * np.cos(azimuth), distance * np.sin(azimuth), np.zeros(len(distance))], axis=1)
    return RadarScan(
        origin.sensor, header(message, encoding).stamp_ns, origin.log_ns, xyz.astype(np.float32),
        rate.astype(np.float32), strength.astype(np.float32), distance.astype(np.float32), azimuth.astype(np.float32),
        frame_number=origin.frame_number,
    )  # fmt: skip


def esr_return(kind: str, message: Any, encoding: str, origin: Origin) -> RadarScan:
    """Read an EsrTrack: one return, none where the radar has no target under this number."""
    return _scan(message, encoding, origin, _ESR, is_there=bool(get(message, "status")))


def mrr_return(kind: str, message: Any, encoding: str, origin: Origin) -> RadarScan:
    """Read an MrrDetection: one return, none where it isn't valid."""
    return _scan(message, encoding, origin, _MRR, is_there=bool(get(message, "valid_level")))


def _scan(message: Any, encoding: str, origin: Origin, polar: Polar, *, is_there: bool) -> RadarScan:
    parts = [message] if is_there and float(get(message, polar.range)) > 0 else []
    return polar_scan(parts, polar, header(message, encoding).stamp_ns, origin)


def return_number(message: Any) -> int:
    """Return which one of its scan a message is."""
    number = find(message, "id", "detection_id")
    if not isinstance(number, int):
        raise DecodeError("return without a number")
    return number


class ReturnAssembler(Assembler):
    """Joins returns to scans: a scan ends with return 64, or before a number that isn't larger than the last one. It
    has the stamp of its first return, and the log time at which it is known to be whole.
    """

    def __init__(self, read: Callable[[memoryview, Origin], tuple[int, RadarScan]]) -> None:
        self._read = read
        self._parts: list[RadarScan] = []
        self._last = 0

    def take(self, data: memoryview, origin: Origin) -> Message | None:
        """Take a message; return the scan that it completes, if any."""
        number, part = self._read(data, origin)
        whole = None
        if self._parts and number <= self._last:
            whole = self._join(origin)
        self._parts.append(part)
        self._last = number
        return self._join(origin) if whole is None and number >= _LAST else whole

    def _join(self, origin: Origin) -> RadarScan:
        parts, self._parts = self._parts, []
        columns: dict[str, Any] = {}
        for name in ("xyz", "radial_velocity_mps", "rcs_dbsm", "range_m", "azimuth_rad"):
            arrays = [getattr(part, name) for part in parts]
            columns[name] = None if any(array is None for array in arrays) else np.concatenate(arrays)
        return replace(parts[0], log_ns=origin.log_ns, **columns)
