"""Which share of a run could be scored at all."""

from dataclasses import dataclass

from fbench.replay.store import Run


@dataclass(frozen=True)
class Coverage:
    """How many outputs of a run had truth: one a frame, of a frame that failed too."""

    num_labelled: int
    num_frames: int
    num_between: int = 0
    """Labelled ones that have no truth of their own, but lie between truths."""

    @property
    def share(self) -> float:
        """From 0 to 1; a run without frames has nothing to label."""
        return self.num_labelled / self.num_frames if self.num_frames else 1.0

    def __str__(self) -> str:
        """Such as `97.8 % of outputs had truth (176 of 180 frames)`."""
        frames = f"{self.num_labelled} of {self.num_frames} {'frame' if self.num_frames == 1 else 'frames'}"
        between = f", {self.num_between} of them by interpolation" if self.num_between else ""
        return f"{_percent(self)} % of outputs had truth ({frames}{between})"


def coverage_of(run: Run) -> Coverage:
    """How many frames of a run have truth."""
    num_labelled = sum(frame.truth_stamp_ns is not None for frame in run.frames)
    return Coverage(num_labelled, len(run.frames), run.manifest.interpolation.num_frames)


def _percent(coverage: Coverage) -> str:
    """Only all is 100, and only nothing is 0."""
    if coverage.share in (0.0, 1.0):
        return f"{100 * coverage.share:.0f}"
    return f"{min(max(100 * coverage.share, 0.1), 99.9):.1f}"
