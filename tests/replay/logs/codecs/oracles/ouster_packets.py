"""Made-up packets of Ouster sensors, with their metadata; needs numpy alone, as the reference runs elsewhere."""

import json
import struct

import numpy as np

WIDTH, HEIGHT, PER_PACKET, WINDOW = 512, 16, 16, (0, 63)
PROFILES = {
    "LEGACY": 3, "RNG19_RFL8_SIG16_NIR16": 3, "RNG19_RFL8_SIG16_NIR16_DUAL": 4, "RNG15_RFL8_NIR8": 1,
    "RNG15_RFL8_NIR8_DUAL": 2, "RNG15_RFL8_NIR8_ZONE16": 2, "RNG19_RFL8_SIG16_NIR16_ZONE16": 3,
    "RNG19_RFL8_SIG16_ZONE16_DUAL": 4, "FIVE_WORD_PIXEL": 5, "RNG19_RFL8_SIG16_NIR16_RGB16": 4,
}  # fmt: skip
"""Words of a pixel by profile."""
START_NS = 1_700_000_000_123_456_789
STEP_NS = 195_312  # Of columns, at 10 turns of 512 columns a second


def metadata(profile: str, *, old: bool = False, up_mm: float = 0.0) -> str:
    """Metadata as firmware of the first (`old`) or of the third generation has them; lidar and sensor axes are one."""
    beams = {
        "beam_altitude_angles": np.linspace(20, -20, HEIGHT).round(2).tolist(),
        "beam_azimuth_angles": [4.2, 1.4, -1.4, -4.2] * (HEIGHT // 4),
        "lidar_origin_to_beam_origin_mm": 15.8,
    }
    identity = np.eye(4).ravel().tolist()
    data = {
        "column_window": WINDOW, "columns_per_frame": WIDTH, "columns_per_packet": PER_PACKET,
        "pixel_shift_by_row": [12, 4, -4, -12] * (HEIGHT // 4), "pixels_per_column": HEIGHT,
        "udp_profile_imu": "LEGACY", "udp_profile_lidar": profile,
    }  # fmt: skip
    info = {
        "prod_line": "OS-1-16", "prod_pn": "840-103575-06", "prod_sn": "122246000293", "status": "RUNNING",
        "build_rev": "v3.0.1", "image_rev": "ousteros-image-prod-bootes-v3.0.1+20230203", "initialization_id": 7,
    }  # fmt: skip
    if old:
        return json.dumps({**beams, **info, "data_format": data, "lidar_mode": "512x10",
                           "lidar_to_sensor_transform": identity, "imu_to_sensor_transform": identity})  # fmt: skip
    transform = np.eye(4)
    transform[[0, 2], 3] = 15.8, up_mm
    return json.dumps({
        "beam_intrinsics": {**beams, "beam_to_lidar_transform": transform.ravel().tolist()},
        "lidar_data_format": data, "lidar_intrinsics": {"lidar_to_sensor_transform": identity},
        "imu_intrinsics": {"imu_to_sensor_transform": identity}, "sensor_info": info, "calibration_status": {},
        "config_params": {"lidar_mode": "512x10", "timestamp_mode": "TIME_FROM_INTERNAL_OSC",
                          "udp_profile_lidar": profile, "columns_per_packet": PER_PACKET},
    })  # fmt: skip


def packet(profile: str, frame: int, first: int, words: np.ndarray, start_ns: int = START_NS, valid: int = 1) -> bytes:
    """One packet: pixels are `words` (16, 16, W), columns `first` and the 15 after it."""
    columns = []
    for i, pixels in enumerate(words.astype("<u4")):
        time = start_ns + (first + i) * STEP_NS
        if profile == "LEGACY":
            status = 0xFFFFFFFF if valid else 0
            head, tail = struct.pack("<QHHI", time, first + i, frame, 0), struct.pack("<I", status)
        else:
            head, tail = struct.pack("<QHH", time, first + i, valid), b""
        columns.append(head + pixels.tobytes() + tail)
    if profile == "LEGACY":
        return b"".join(columns)
    return struct.pack("<HH", 1, frame) + bytes(28) + b"".join(columns) + bytes(32)


def packets(profile: str, frame: int = 300, start_ns: int = START_NS) -> list[bytes]:
    """The packets of one turn, full of any numbers; a fifth of the pixels has no return."""
    rng = np.random.Generator(np.random.Philox(len(profile)))
    found = []
    for first in range(WINDOW[0], WINDOW[1] + 1, PER_PACKET):
        words = rng.integers(0, 2**32, (PER_PACKET, HEIGHT, PROFILES[profile]))
        words[rng.random((PER_PACKET, HEIGHT)) < 0.2] = 0
        found.append(packet(profile, frame, first, words, start_ns))
    return found
