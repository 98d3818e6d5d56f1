"""What a benchmark calls the boxes of a run or log: by the source's own word where it is one of its, else by the label
of fbench. The tables are those by which boxes are exported.
"""

from typing import Literal

import numpy as np

from fbench.replay.arrays import Bool, Text, text_array
from fbench.replay.export.classes import TABLES, ClassTable

Family = Literal["kitti-tracking", "mot", "nuscenes", "nuscenes-tracking"]
"""Benchmarks with one set of classes, called as the formats of `fbench log export`."""
RACK = "static_object.bicycle_rack"
"""nuScenes' truth tells where bicycles stand that don't count."""
_REGIONS = {"kitti-tracking": "dontcare", "mot": "distractor"}
"""What truth that is to be ignored is called, where a flag doesn't do."""


def names_of(family: Family | None, source_labels: Text, labels: Text, ignored: Bool) -> Text:
    """Return the benchmark's name (N,) of each box in lower case; empty where it has none, or the box has no class.

    Args:
        family: Of the benchmark; `None`: the source's own words, else fbench's.
        source_labels: (N,) as the source names classes; empty where it doesn't.
        labels: (N,) of fbench.
        ignored: (N,) truth that is neither a hit nor a miss.
    """
    if not len(labels):
        return np.zeros(0, "U1")
    if family is None:
        return text_array([own.lower() or label for own, label in zip(source_labels, labels, strict=True)])
    table, region = TABLES[family], _REGIONS.get(family, "")
    triples = list(zip(source_labels.tolist(), labels.tolist(), ignored.tolist(), strict=True))
    known = {triple: _name(table, region, *triple) for triple in dict.fromkeys(triples)}
    return text_array([known[triple] for triple in triples])


def _name(table: ClassTable, region: str, source_label: str, label: str, is_ignored: bool) -> str:
    # A word of MOTChallenge says by itself whether it excuses what is found there; KITTI has but one for all regions.
    if is_ignored and region and (region == "dontcare" or source_label not in table.own):
        return region
    if source_label == RACK:
        return RACK
    return (table.name(source_label, label) or "").lower()
