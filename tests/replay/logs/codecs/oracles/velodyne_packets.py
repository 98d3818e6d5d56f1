"""Made-up packets of each Velodyne that fbench decodes; needs numpy alone, as the reference decoder runs elsewhere."""

import numpy as np

MODELS = {"hdl32e": 0x21, "vlp16": 0x22, "puck_hires": 0x24, "vlp32c": 0x28, "vls128": 0xA1}
STRONGEST, LAST, DUAL = 0x37, 0x38, 0x39
BANKS = (0xEEFF, 0xDDFF, 0xCCFF, 0xBBFF)
SHOT = np.dtype([("distance", "<u2"), ("intensity", "u1")])
BLOCK = np.dtype([("flag", "<u2"), ("azimuth", "<u2"), ("shots", SHOT, (32,))])
PACKET = np.dtype([("blocks", BLOCK, (12,)), ("stamp_us", "<u4"), ("mode", "u1"), ("model", "u1")])
PERIOD_US = {0x21: 552.96, 0x22: 1327.104, 0x24: 1327.104, 0x28: 663.552, 0xA1: 160.0}  # Of a packet, single mode


def empty(model: int, mode: int = STRONGEST, num: int = 1) -> np.ndarray:
    """Packets without returns, with the flags and the model that the sensor sets."""
    table = np.zeros(num, PACKET)
    table["mode"], table["model"] = mode, model
    flags = np.full(12, BANKS[0])
    if model == 0xA1:
        flags = np.resize(BANKS, 12) if mode != DUAL else np.r_[np.repeat(BANKS, 2), [0xFFFF] * 4]
    table["blocks"]["flag"] = flags
    return table


def packets(model: int, mode: int, num: int = 4, start: int = 35_800) -> np.ndarray:
    """A few packets (N, 1206) of a sensor that turns 12.3 deg each millisecond, across azimuth 0."""
    rng = np.random.Generator(np.random.Philox(model + mode))
    table = empty(model, mode, num)
    period_us = PERIOD_US[model] / (2 if mode == DUAL and model != 0xA1 else 3 if mode == DUAL else 1)
    at_us = 1_000_000 + period_us * np.arange(num)
    table["stamp_us"] = at_us
    blocks_per_column = {(True, True): 12, (True, False): 4, (False, True): 2, (False, False): 1}
    columns = np.arange(12) // blocks_per_column[model == 0xA1, mode == DUAL]
    per_column = PERIOD_US[model] / (3 if model == 0xA1 else 12)
    at = at_us[:, None] + columns * per_column
    table["blocks"]["azimuth"] = np.round(start + 1.23 * (at - at_us[0])) % 36_000
    shots = table["blocks"]["shots"]
    shots["distance"] = rng.integers(500, 60_000, shots.shape) * (rng.random(shots.shape) < 0.9)
    shots["intensity"] = rng.integers(0, 256, shots.shape)
    if mode == DUAL:  # some last returns are the strongest ones
        same = rng.random((num, 6, 32)) < 0.3
        for name in ("distance", "intensity"):
            shots[name][:, 1::2] = np.where(same, shots[name][:, 0::2], shots[name][:, 1::2])
    return table.view(np.uint8).reshape(num, 1206)
