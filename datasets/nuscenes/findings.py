"""What the import of a scene met, for its summary."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from fbench.datasets.nuscenes.excerpt import Excerpt
from fbench.datasets.nuscenes.truth import LABELS
from fbench.replay.data import KINDS, Boxes3D, Rig
from fbench.replay.imports.words import counted, listed

_LISTED = 10


@dataclass
class Findings:
    """Counts of one scene."""

    keyframes: Counter[str] = field(default_factory=Counter)
    """By sensor."""
    sweeps: Counter[str] = field(default_factory=Counter)
    gaps: dict[str, list[int]] = field(default_factory=dict)
    """Samples that lack a keyframe, by sensor."""
    poses: int = 0
    echoes: int = 0
    dropped: int = 0
    """Echoes that the filter dropped."""
    categories: Counter[str] = field(default_factory=Counter)
    tracks: set[int] = field(default_factory=set)
    with_velocity: int = 0
    labelled: int = 0
    """Samples with truth."""

    def add_boxes(self, boxes: Boxes3D) -> None:
        """Count truth."""
        self.labelled += 1
        if boxes.source_label is not None and boxes.track_id is not None and boxes.velocity_mps is not None:
            self.categories.update(boxes.source_label.tolist())
            self.tracks.update(boxes.track_id.tolist())
            self.with_velocity += int(np.isfinite(boxes.velocity_mps).all(axis=1).sum())


def summary_lines(found: Findings, excerpt: Excerpt, rig: Rig, filtered: bool) -> list[str]:
    """Say what was found and what was odd."""
    return [*_sensor_lines(found, excerpt, rig), *_radar_lines(found, rig, filtered), *_box_lines(found)]


def _sensor_lines(found: Findings, excerpt: Excerpt, rig: Rig) -> Iterator[str]:
    samples, chain = excerpt.samples, excerpt.chain
    seconds = (chain[samples[-1]].stamp_us - chain[samples[0]].stamp_us) / 1e6 if samples else 0.0
    yield f"samples: {len(samples)} of {len(chain)}, {seconds:.1f} s"
    for kind in KINDS:
        names = rig.sensors(KINDS[kind])
        keys, sweeps = sum(found.keyframes[name] for name in names), sum(found.sweeps[name] for name in names)
        if names:
            yield f"{kind}: {len(names)} ({', '.join(names)}), {keys} keyframes, {sweeps} sweeps"
    yield f"poses: {found.poses}"
    gaps = [f"{name} {listed(numbers, _LISTED)}" for name, numbers in sorted(found.gaps.items())]
    yield f"samples without a keyframe: {'; '.join(gaps) or 'none'}"


def _radar_lines(found: Findings, rig: Rig, filtered: bool) -> Iterator[str]:
    if rig.sensors("radar") and filtered:
        yield f"radar: the filter dropped {found.dropped} of {found.echoes} echoes; --set radar_filter=false keeps them"


def _box_lines(found: Findings) -> Iterator[str]:
    if not found.labelled:
        yield "boxes: none, the set isn't labelled"
        return
    names, total = counted(found.categories), found.categories.total()
    facts = f"{len(found.tracks)} tracks, {found.with_velocity} with velocity"
    yield f"boxes: {total}{f' ({names})' if names else ''}, {facts}"
    unknown = sorted(name for name in found.categories if name not in LABELS)
    if unknown:
        yield f"categories that nuScenes lacks, taken as 'other': {', '.join(unknown)}"
