"""Write `ouster.json`: what ouster-sdk 1.0.1 makes of the made-up packets.

Run it in an environment of its own: `pip install ouster-sdk==1.0.1`, then `python make_ouster.py`.
"""

import json
from pathlib import Path

import numpy as np
from ouster.sdk import core
from ouster_packets import PROFILES, metadata, packets  # type: ignore[import-not-found]

EVERY = 97  # Of which points one is kept


def decode(profile, text):
    info = core.SensorInfo(text)
    form, lut = core.PacketFormat(info), core.XYZLut(info, False)
    names = [n for n in ("RANGE", "RANGE2") if n in form.fields]
    rows = []
    for number, name in enumerate(names):
        image = np.zeros((info.h, info.w), np.uint32)
        signal = np.zeros((info.h, info.w), np.float64)
        kept = ("SIGNAL", "REFLECTIVITY")["SIGNAL" not in form.fields] + "2" * number
        for data in packets(profile):
            buffer = np.frombuffer(data, np.uint8)
            columns = form.packet_header(core.ColHeader.MEASUREMENT_ID, buffer)
            image[:, columns] = form.packet_field(name, buffer)
            signal[:, columns] = form.packet_field(kept, buffer)
        xyz = lut(image)
        rows += [
            (int(v), int(u), *xyz[u, v].round(6).tolist(), float(signal[u, v])) for v, u in np.argwhere(image.T > 0)
        ]
    return {"num": len(rows), "rows": rows[::EVERY]}


found = {profile: decode(profile, metadata(profile)) for profile in PROFILES}
found["old LEGACY"] = decode("LEGACY", metadata("LEGACY", old=True))
found["up RNG15_RFL8_NIR8"] = decode("RNG15_RFL8_NIR8", metadata("RNG15_RFL8_NIR8", up_mm=7.5))
Path(__file__).with_name("ouster.json").write_text(json.dumps(found) + "\n")
