"""How well cameras see at present, told by what LiDAR and radar see together: nobody has to say that it is night."""

import numpy as np

from fbench.replay.boxes import Boxes2D
from fbench.replay.data import Source

_BEFORE, _SEEN_BEFORE = 20.0, 18.0
"""Before anything was seen, cameras are taken to have seen 9 of 10 objects."""
_KEPT = 0.97
"""Share of what was seen that still counts one frame later."""
_BOTH = int(Source.L) | int(Source.R)


class CameraTrust:
    """Share of the objects that both LiDAR and radar see which cameras see too, over some twenty frames."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Begin a segment."""
        self._num, self._num_seen = _BEFORE, _SEEN_BEFORE

    @property
    def share(self) -> float:
        """0 to 1."""
        return self._num_seen / self._num

    def learn(self, objects: Boxes2D) -> None:
        """Take the objects of a frame that are reported in images of cameras that worked."""
        sources = np.zeros(0, np.uint8) if objects.sources is None else objects.sources
        score = np.zeros(len(objects)) if objects.score is None else objects.score
        sure = np.where((sources & _BOTH) == _BOTH, np.clip(2 * score - 1, 0.0, 1.0), 0.0)
        self._num = _KEPT * self._num + float(sure.sum())
        self._num_seen = _KEPT * self._num_seen + float(sure[(sources & int(Source.C)) > 0].sum())
        if self._num < 1.0:  # long without anything to learn from: as in the beginning
            self.reset()
