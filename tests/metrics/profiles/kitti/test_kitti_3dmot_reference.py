"""AB3DMOT's own evaluation against ours, on made-up sequences."""

import json
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

import pytest
from tests.metrics.profiles.kitti.kitti_rows import tracking_sequence
from tests.metrics.profiles.kitti.oracles.kitti_tracks_input import SEQUENCES, made_sequence

from fbench.metrics.profiles.kitti.rows import Tables
from fbench.metrics.profiles.kitti.track_passes import TrackTable, run_passes
from fbench.metrics.profiles.kitti.tracking import Kitti3dMot
from fbench.replay.contracts.profiles import Match

REFERENCE = json.loads((Path(__file__).parent / "oracles/kitti_3dmot.json").read_text())
MATCHES = {name: Match("iou3d" if name[0] == "3" else "iou2d", float(name.split()[1])) for name in REFERENCE}
ROWS = {
    "mota": "MOTA", "motp": "MOTP", "motal": "MOTAL", "moda": "MODA", "modp": "MODP", "recall": "recall",
    "precision": "precision", "f1": "F1", "far": "FAR", "mt": "MT", "pt": "PT", "ml": "ML", "ids": "id_switches",
    "frag": "fragments", "tp": "tp", "itp": "itp", "fp": "fp", "fn": "fn", "ifn": "ifn",
    "ignored_gt_objects": "n_igt", "gt_tracks": "n_gt_trajectories", "tracker_objects": "n_tr",
    "ignored_tracker_objects": "n_itr", "tracker_tracks": "n_tr_trajectories",
}  # fmt: skip
COUNTS = {"tp": "tp", "itp": "itp", "fp": "fp", "fn": "fn", "ifn": "ifn", "ids": "id_switches", "frag": "fragments",
          "gt": "n_gt",
    "threshold": "threshold",
    "recall": "aim", "results": "n_tr", "ignored_results": "n_itr"}  # fmt: skip


@pytest.fixture(scope="module")
def sequences():
    made = enumerate(SEQUENCES.items())
    return [tracking_sequence(name, *made_sequence(seed, length, 9.0), length) for seed, (name, length) in made]


def statistics(profile: Kitti3dMot, sequences: Any) -> Tables[TrackTable]:
    return reduce(add, map(profile.measure, sequences))


@pytest.mark.parametrize("case", REFERENCE)
def test_every_printed_entry_is_ab3dmots(case, sequences):
    profile = Kitti3dMot().with_match(MATCHES[case])
    rows = profile.scores(statistics(profile, sequences), "all")
    assert {row.class_ for row in rows} == set(REFERENCE[case])
    for label, wanted in REFERENCE[case].items():
        own = {row.metric: row.value for row in rows if row.class_ == label}
        for metric, name in ROWS.items():
            assert own[metric] == pytest.approx(wanted["best"][name], rel=1e-12, abs=1e-9), (label, metric)
        for metric, name in (("samota", "sAMOTA"), ("amota", "AMOTA"), ("amotp", "AMOTP")):
            assert own[metric] == pytest.approx(wanted[name], abs=1e-9), (label, metric)
        assert own["gt_objects"] == wanted["best"]["n_gt"] + wanted["best"]["n_igt"]


@pytest.mark.parametrize("case", REFERENCE)
def test_every_count_at_every_threshold_is_ab3dmots(case, sequences):
    profile = Kitti3dMot().with_match(MATCHES[case])
    tables = statistics(profile, sequences).tables
    for i, kind in enumerate(profile.classes):
        wanted = REFERENCE[case][kind.label]["recalls"]
        passes, _ = run_passes([own[i] for own in tables], 40)
        for ours, name in COUNTS.items():
            assert [getattr(one, ours) for one in passes] == wanted[name], (kind.label, ours)
        assert [one.smota for one in passes] == pytest.approx(wanted["sMOTA"], abs=1e-12)
