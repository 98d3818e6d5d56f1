"""Decoding packets of LiDARs to points, against reading the same points from a cloud."""

import json
import time
from functools import partial

import numpy as np
from common import best_s

from fbench.replay.data.arrays import Array, Float32
from fbench.replay.logs.codecs import velodyne
from fbench.replay.logs.codecs.codec import Origin
from fbench.replay.logs.codecs.ouster import OusterFormat, read_metadata
from fbench.replay.logs.codecs.packed_points import Columns, PointField, lidar_sweep

SCANS = {"VLP-16": (0x22, 76), "HDL-32E": (0x21, 181), "VLS-128": (0xA1, 625)}  # Packets of a turn at 10 Hz
FLAGS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
TYPES = {0: "f4", 1: "u2"}


def velodyne_packets(model: int, num: int) -> Array:
    """Packets of noise, 94 % of which are returns."""
    packets = np.random.default_rng(1).integers(0, 256, (num, velodyne.SIZE)).astype(np.uint8)
    packets[:, 1204:] = 0x37, model
    for block in range(12):
        flag = FLAGS[block % 4 if model == 0xA1 else 0]
        packets[:, 100 * block : 100 * block + 4] = flag & 0xFF, flag >> 8, block, 0
    return packets


def ouster() -> tuple[OusterFormat, list[bytes]]:
    """A sensor with 128 beams and 1024 columns, and a turn of noise."""
    angles = np.linspace(20, -20, 128).tolist()
    tables = {
        "beam_altitude_angles": angles, "beam_azimuth_angles": angles, "lidar_mode": "1024x10",
        "data_format": {"columns_per_frame": 1024, "udp_profile_lidar": "RNG19_RFL8_SIG16_NIR16"},
    }  # fmt: skip
    sensor = read_metadata(json.dumps(tables))
    packets = np.random.default_rng(1).integers(0, 256, (64, sensor.packet_size)).astype(np.uint8)
    columns = packets[:, 32:-32].reshape(64, 16, -1)
    columns[:, :, :12] = np.arange(1024, dtype=np.uint8).reshape(64, 16, 1) * (np.arange(12) == 8)
    columns[:, :, 9], columns[:, :, 10] = np.arange(1024).reshape(64, 16) >> 8, 1
    return sensor, [packet.tobytes() for packet in packets]


def cloud_s(xyz: Float32, intensity: Float32, ring: Array) -> float:
    """Time to read a cloud with these points."""
    rows = np.zeros(len(xyz), [("xyz", "<f4", 3), ("intensity", "<f4"), ("ring", "<u2")])
    rows["xyz"], rows["intensity"], rows["ring"] = xyz, intensity, ring
    names = ((0, "x"), (4, "y"), (8, "z"), (12, "intensity"), (16, "ring"))
    fields = [PointField(name, offset, int(name == "ring")) for offset, name in names]
    columns = Columns(fields, TYPES, memoryview(rows.tobytes()), (1, len(rows)), (rows.nbytes, rows.itemsize))
    return best_s(partial(lidar_sweep, columns, 0, Origin("", 0, 0)), clock=time.process_time)


def report(name: str, own_s: float, points: tuple[Float32, Float32, Array]) -> None:
    num, ratio = len(points[0]), own_s / cloud_s(*points)
    print(f"{name}: {num} points in {own_s * 1e3:.1f} ms, {ratio:.1f} times as long as a cloud with them")


def main() -> None:
    for name, (model, num) in SCANS.items():
        data = velodyne_packets(model, num)
        points = velodyne.decode(data)
        own_s = best_s(partial(velodyne.decode, data), clock=time.process_time)
        report(name, own_s, (points.xyz, points.intensity, points.ring))
    sensor, packets = ouster()
    turn = sensor.decode(packets)
    assert turn is not None
    own_s = best_s(partial(sensor.decode, packets), clock=time.process_time)
    report("Ouster, 128 beams", own_s, (turn.xyz, turn.intensity, turn.ring))


if __name__ == "__main__":
    main()
