"""Write `velodyne.json`: what velodyne-decoder 3.1.0 makes of the made-up packets.

Run it in an environment of its own: `pip install velodyne-decoder==3.1.0`, then `python make_velodyne.py`.
"""

import json
from pathlib import Path

import velodyne_decoder as vd
from velodyne_packets import DUAL, MODELS, STRONGEST, packets  # type: ignore[import-not-found]

EVERY = 41  # Of which points one is kept

found = {}
for name, model in MODELS.items():
    for mode in (STRONGEST, DUAL):
        decoder = vd.ScanDecoder(vd.Config(min_range=0.0, max_range=1000.0, timestamp_first_packet=True))
        data = vd.PacketVector([vd.VelodynePacket(1.0, list(packet.tobytes())) for packet in packets(model, mode)])
        _, points = decoder.decode(data, True)
        columns = [points[k].astype(float) for k in ("time", "ring", "x", "y", "z", "intensity")]
        rows = sorted(zip(*(column.round(9).tolist() for column in columns), strict=True))
        # It learns speed and firmware of a VLS-128 from the first packet.
        first_s = 0.0 if name != "vls128" else 170e-6 if mode == STRONGEST else 52e-6
        found[f"{name} {mode:#x}"] = {"num": len(rows), "rows": [row for row in rows if row[0] >= first_s][::EVERY]}
Path(__file__).with_name("velodyne.json").write_text(json.dumps(found) + "\n")
