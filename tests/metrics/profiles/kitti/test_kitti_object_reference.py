"""OpenPCDet's evaluation of KITTI's object benchmark against ours, on made-up frames."""

import json
from pathlib import Path

import pytest
from tests.metrics.profiles.kitti.kitti_frames import object_sequence
from tests.metrics.profiles.kitti.oracles.kitti_objects_input import made_frames

from fbench.metrics.profiles.kitti.object import KittiObject

REFERENCE = json.loads((Path(__file__).parent / "oracles/kitti_object.json").read_text())
CASES = {"sparse": (0, 80, 12.0), "crowded": (1, 60, 3.0)}
KINDS = {"iou2d": "bbox", "ioubev": "bev", "iou3d": "3d"}


@pytest.mark.parametrize("case", REFERENCE)
def test_ap_and_aos_are_openpcdets(case):
    profile, frames = KittiObject(), made_frames(*CASES[case])
    parts = [object_sequence(str(i), frames[i : i + 13]) for i in range(0, len(frames), 13)]
    total = profile.measure(parts[0])
    for part in parts[1:]:
        total = total + profile.measure(part)
    rows = {(r.class_, r.matching, r.slice, r.metric): r for r in profile.scores(total, "all")}
    differences = {}
    for c, kind in enumerate(profile.classes):
        for m, match in enumerate(kind.matches):
            for d, difficulty in enumerate(profile.difficulties):
                for metric, suffix in (("ap", "_R40"), ("ap11", ""), ("aos", "_R40"), ("aos11", "")):
                    if metric[:3] == "aos" and m > 0:
                        continue
                    name = ("aos" if metric[:3] == "aos" else KINDS[match.kind]) + suffix
                    own = rows[kind.label, str(match), f"all, {difficulty.name}", metric]
                    wanted = REFERENCE[case][name][c][d][int(m > 2)] / 100
                    if own.value is None or abs(own.value - wanted) > 1e-9:
                        differences[kind.label, str(match), difficulty.name, metric] = own.value, wanted
    assert not differences
