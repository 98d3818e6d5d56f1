"""Waymo's own test files: what its tools print for them, as their sources say.

The files aren't in this repository; they are `fake_predictions.bin` and `fake_ground_truths.bin` from
`src/waymo_open_dataset/metrics/tools` of github.com/waymo-research/waymo-open-dataset, put into `shared/data/waymo`
beside the recordings, or where `WAYMO_FIXTURES` says.
"""

import os
import struct
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from fbench.metrics.profiles.waymo.profile import WaymoProfile
from fbench.replay.contracts.profiles import Match
from fbench.replay.data.sequences import Objects, Sequence, Steps

FOLDER = Path(os.environ.get("WAYMO_FIXTURES", Path(__file__).resolve().parents[5] / "shared/data/waymo"))
TYPES = ("unknown", "vehicle", "pedestrian", "sign", "cyclist")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not (FOLDER / "fake_predictions.bin").is_file(), reason="Waymo's test files aren't there"),
]

# Printed for the files: [mAP] [mAPH] by `compute_detection_metrics_main.cc`
PLAIN = """
vehicle, level 1: 0.208277 0.162823
vehicle: 0.20542 0.160523
pedestrian, level 1: 0.129258 0.0984962
pedestrian: 0.125136 0.0953438
sign, level 1: 0.0926278 0.0635938
sign: 0.067927 0.0466355
vehicle, 0-30 m, level 1: 0.154727 0.129927
vehicle, 0-30 m: 0.154727 0.129927
vehicle, 30-50 m, level 1: 0.27302 0.230956
vehicle, 30-50 m: 0.270492 0.228818
vehicle, from 50 m, level 1: 0.218596 0.155501
vehicle, from 50 m: 0.212188 0.150963
pedestrian, 0-30 m, level 1: 0.19352 0.155428
pedestrian, 0-30 m: 0.19352 0.155428
pedestrian, 30-50 m, level 1: 0.144201 0.103131
pedestrian, 30-50 m: 0.134931 0.0966024
pedestrian, from 50 m, level 1: 0.0985548 0.0779858
pedestrian, from 50 m: 0.0960544 0.075891
sign, 0-30 m, level 1: 0.106175 0.0716929
sign, 0-30 m: 0.0651952 0.0439717
sign, 30-50 m, level 1: 0.15528 0.117763
sign, 30-50 m: 0.13587 0.103042
sign, from 50 m, level 1: 0.075276 0.0507518
sign, from 50 m: 0.0596342 0.040206
"""
# [LET-mAPL] [LET-mAP] [LET-mAPH] by `compute_detection_let_metrics_main.cc`
TOLERANT = """
vehicle: 0.211287 0.23023 0.181574
pedestrian: 0.213379 0.224676 0.170878
sign: 0.0989853 0.100288 0.0797784
vehicle, 0-30 m: 0.158502 0.200029 0.163429
vehicle, 30-50 m: 0.231184 0.244745 0.205553
vehicle, from 50 m: 0.232808 0.241251 0.175992
pedestrian, 0-30 m: 0.214398 0.228197 0.17427
pedestrian, 30-50 m: 0.202346 0.21114 0.158337
pedestrian, from 50 m: 0.193137 0.201656 0.158395
sign, 0-30 m: 0.0196413 0.0196586 0.018337
sign, 30-50 m: 0.191365 0.191489 0.150585
sign, from 50 m: 0.149141 0.151854 0.125403
"""


def fields(data: bytes) -> Iterator[tuple[int, bytes | int]]:
    """Yield number and content of the fields of one protobuf message."""
    at = 0

    def varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value

    while at < len(data):
        number, kind = divmod(varint(), 8)
        if kind == 0:
            yield number, varint()
            continue
        size = {1: 8, 5: 4}.get(kind) or varint()
        yield number, data[at : at + size]
        at += size


@cache
def read(name: str) -> tuple[dict[str, object], ...]:
    """Objects of one file, by `Object`, `Label` and `Box` of Waymo's `metrics.proto` and `label.proto`."""
    found = []
    for number, content in fields((FOLDER / name).read_bytes()):
        if number == 1 and isinstance(content, bytes):
            whole = dict(fields(content))
            label = dict(fields(whole[1]))  # type: ignore[arg-type]

            def box(key: int, label: dict[int, bytes | int] = label) -> list[float]:
                own = dict(fields(label.get(key, b"")))  # type: ignore[arg-type]
                values = [struct.unpack("<d", own[k])[0] if k in own else 0.0 for k in (1, 2, 3, 5, 4, 6, 7)]  # type: ignore[arg-type]
                return [float(v) for v in values]

            found.append({
                "frame": (whole.get(4, b""), whole.get(6, 0), whole.get(5, 0)),
                "score": struct.unpack("<f", whole[2])[0] if 2 in whole else 1.0,  # type: ignore[arg-type]
                "type": TYPES[label.get(3, 0)],  # type: ignore[index]
                "box": box(1), "synced": box(12), "level": label.get(5, 0), "camera": label.get(11, b""),
                "points": label.get(7, 0), "top_points": label.get(13, 0),
            })  # fmt: skip
    return tuple(found)


def sequence(tolerant: bool) -> Sequence:
    truth, said = list(read("fake_ground_truths.bin")), list(read("fake_predictions.bin"))
    points = "top_points" if tolerant else "points"
    truth = [t for t in truth if t[points] and (t["camera"] or not tolerant)]
    frames = sorted({str(o["frame"]) for o in (*truth, *said)})

    def side(objects: list[dict[str, object]], is_truth: bool) -> Objects:
        step = np.array([frames.index(str(o["frame"])) for o in objects])
        order = np.argsort(step, kind="stable")
        rows = [objects[k] for k in order]
        boxes = np.array([r["synced" if tolerant and is_truth else "box"] for r in rows])
        # A level that people gave counts; else points tell.
        given = [{1: 10, 2: 1}.get(r["level"], r[points]) for r in rows]  # type: ignore[call-overload]
        return Objects(
            step[order], np.array([r["type"] for r in rows]), np.full(len(rows), -1),
            np.array([r["score"] for r in rows], float), center_m=boxes[:, :3], size_lwh_m=boxes[:, 3:6],
            yaw_rad=boxes[:, 6], num_points=np.array(given) if is_truth else None,
        )  # fmt: skip

    if not tolerant:
        # Waymo's polygons find no overlap of this box with a truth box that is the same, turned by exactly 180 deg.
        # Raised, it overlaps nothing here either; all other pairs of this kind do overlap there.
        turned = [k for k, o in enumerate(said) if abs(float(o["score"]) - 0.14504942) < 1e-8]  # type: ignore[arg-type]
        assert len(turned) == 1
        box = list(said[turned[0]]["box"])  # type: ignore[call-overload]
        said[turned[0]] = said[turned[0]] | {"box": [*box[:2], box[2] + 6, *box[3:]]}
    return Sequence("fake", Steps.of_one_stream(len(frames)), side(truth, True), side(said, False))


@pytest.mark.parametrize("tolerant", [False, True])
def test_numbers_are_those_that_waymos_tools_print(tolerant: bool) -> None:
    profile = WaymoProfile().with_match(Match("let", 0.5)) if tolerant else WaymoProfile()
    names = ("let_apl", "let_ap", "let_aph") if tolerant else ("ap", "aph")
    rows = profile.scores(profile.measure(sequence(tolerant)), "all")
    values = {(r.class_, r.slice, r.metric): r.value for r in rows}
    wrong = []
    for line in (TOLERANT if tolerant else PLAIN).strip().splitlines():
        where, _, numbers = line.partition(":")
        class_, _, rest = where.partition(", ")
        for name, text in zip(names, numbers.split(), strict=True):
            value = values[class_, f"all, {rest}" if rest else "all", name]
            # Six digits are printed.
            if value is None or abs(value - float(text)) > 1e-6:
                wrong.append((where, name, value, text))
    assert not wrong
