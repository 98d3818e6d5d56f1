"""Raw counts of hits and misses, which can be added over frames and runs."""

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class BoxCounts:
    """Hits and misses."""

    tp: int = 0
    fp: int = 0
    fn: int = 0
    ignored: int = 0
    """Estimates that are neither: outside the region, or on truth that needn't be found."""
    invalid: int = 0
    """Estimates that aren't finite; they are in `fp` too."""
    invalid_truth: int = 0
    """Truth boxes that aren't finite; they are left out."""
    predicted: int = 0
    """Estimates that counted though nothing measured them: predictions of a tracker."""

    def __add__(self, other: "BoxCounts") -> "BoxCounts":
        return BoxCounts(
            self.tp + other.tp, self.fp + other.fp, self.fn + other.fn, self.ignored + other.ignored,
            self.invalid + other.invalid, self.invalid_truth + other.invalid_truth, self.predicted + other.predicted,
        )  # fmt: skip

    @property
    def gt(self) -> int:
        """Truth boxes that had to be found."""
        return self.tp + self.fn

    @property
    def estimates(self) -> int:
        """Estimates that counted."""
        return self.tp + self.fp

    def named(self, with_predicted: bool) -> dict[str, int]:
        """All counts by name; that of predictions only if it is wanted, and isn't 0."""
        counts = asdict(self)
        if not (with_predicted and self.predicted):
            del counts["predicted"]
        return counts
