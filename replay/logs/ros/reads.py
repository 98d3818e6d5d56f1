"""What one type of message can be decoded to."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from fbench.replay.data import CameraModel, Message
from fbench.replay.logs.codec import Origin, Probe
from fbench.replay.logs.tree import Edge
from fbench.replay.logs.truth_part import TruthPart


@dataclass(frozen=True)
class Reads:
    """Functions from payloads to what they hold; `None` where a type holds no such thing."""

    kinds: tuple[str, ...]
    probe: Callable[[memoryview], Probe]
    message: Callable[[str, memoryview, Origin], Message] | None = None
    transforms: Callable[[memoryview], Sequence[tuple[str, Edge]]] | None = None
    stamps: Callable[[memoryview], Sequence[int]] | None = None
    """Of the transforms."""
    calibration: Callable[[memoryview], tuple[str, CameraModel]] | None = None
    truth: Callable[[memoryview, Origin], TruthPart] | None = None
