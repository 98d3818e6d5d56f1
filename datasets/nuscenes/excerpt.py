"""Which part of a scene is imported."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from fbench.datasets.nuscenes.rows import MAX_US
from fbench.datasets.nuscenes.scenes import Instant
from fbench.replay.imports.wish import FrameRange


@dataclass(frozen=True)
class Excerpt:
    """Which samples of a scene are wanted, and what was measured between them."""

    chain: Sequence[Instant]
    """All samples of the scene."""
    frames: FrameRange
    """By number within the scene."""
    sweeps: bool
    """Whether what lies between the samples is wanted."""

    @cached_property
    def samples(self) -> range:
        """Numbers of the samples."""
        num, stop = len(self.chain), self.frames.stop
        return range(min(self.frames.first, num), num if stop is None else min(stop, num))

    def holds(self, sample: int, is_key: bool, stamp_us: int) -> bool:
        """Tell whether a measurement is wanted: of keyframes by their sample, of sweeps by time.

        Sweeps are wanted from the first sample's stamp on until before that of the first sample behind the range;
        those before the scene's first sample come with it, those after its last one with that. So ranges that follow
        each other share nothing and lack nothing.
        """
        if is_key:
            return sample in self.samples
        return self.sweeps and len(self.samples) > 0 and stamp_us in self._stamps_us

    @cached_property
    def _stamps_us(self) -> range:
        first, stop = self.samples.start, self.samples.stop
        begin_us = self.chain[first].stamp_us if first else 0
        return range(begin_us, self.chain[stop].stamp_us if stop < len(self.chain) else MAX_US + 1)
