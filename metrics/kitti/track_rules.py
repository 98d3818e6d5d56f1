"""What AB3DMOT's KITTI evaluation counts and excuses, as data."""

from dataclasses import dataclass

from fbench.metrics.profile import Match


@dataclass(frozen=True)
class TrackClass:
    """A class, and the one that is neither a hit nor a miss beside it."""

    label: str
    neighbour: str = ""

    @property
    def labels(self) -> tuple[str, ...]:
        """Labels whose boxes are matched."""
        return (self.label, self.neighbour) if self.neighbour else (self.label,)


@dataclass(frozen=True)
class TrackRules:
    """Thresholds of `trackingEvaluation` in scripts/KITTI/evaluate.py, AB3DMOT 61f3bd7."""

    match: Match
    min_height_px: float = 25.0
    """Results up to this height are excused where they match nothing."""
    max_occlusion: int = 2
    """Truth above is ignored; in KITTI 3 is unknown."""
    max_truncation: int = 0
    max_covered: float = 0.5
    """Results of which a "don't care" region covers more are excused where they match nothing."""
    num_recalls: int = 40
    """Recalls 1/40 to 1 over which sAMOTA, AMOTA and AMOTP are averaged."""
