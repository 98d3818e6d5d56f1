"""RadarScan of radar_msgs."""

from typing import Any

import numpy as np

from fbench.replay.data.messages import Message, RadarScan
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.ros.decoder import Decode, MessageReader, get, header, probe_header

_FIELDS = ("range", "azimuth", "elevation", "doppler_velocity", "amplitude")


def radar_scan(message: Any, stamp_ns: int, origin: Origin) -> RadarScan:
    """Return a scan: azimuth positive to the left, elevation upwards (REP 103), x = r cos(el) cos(az).

    radar_msgs doesn't define the sign of `doppler_velocity`: it counts as positive when receding. `amplitude` is in
    dB, so `rcs_dbsm` is an uncalibrated magnitude.
    """
    returns = [[get(point, name) for name in _FIELDS] for point in get(message, "returns")]
    table = np.array(returns, np.float64).reshape(-1, len(_FIELDS))
    distance, azimuth, elevation = table[:, 0], table[:, 1], table[:, 2]
    flat = distance * np.cos(elevation)
    xyz = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    polar, xyz32 = table.astype(np.float32), xyz.astype(np.float32)
    return RadarScan(
        origin.sensor, stamp_ns, origin.log_ns, xyz32, polar[:, 3], polar[:, 4], polar[:, 0], polar[:, 1], polar[:, 2],
        origin.frame_number,
    )  # fmt: skip


def radar_scan_reader(decode: Decode, encoding: str) -> MessageReader:
    """RadarScan."""

    def message(kind: str, data: memoryview, origin: Origin) -> Message:
        scan = decode(data)
        return radar_scan(scan, header(scan, encoding).stamp_ns, origin)

    return MessageReader(("radar",), probe_header("radar", decode, encoding), message)
