"""Frames, and the outputs that pipelines make of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from fbench.replay.contracts.errors import DataError
from fbench.replay.data.boxes import Boxes
from fbench.replay.data.messages import Image, Message, PointCloud, RadarScan

ClockName: TypeAlias = Literal["host", "log"]
"""Whose time latencies are measured in: that of this machine, or that of the log."""


@dataclass(frozen=True, eq=False)
class Frame:
    """The messages of all sensors that belong to one instant."""

    index: int
    stamp_ns: int
    segment: int
    messages: Mapping[str, Message]
    """By sensor name."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Why an expected sensor isn't there, by sensor name."""
    frame_number: int | None = None

    @property
    def num_points(self) -> int:
        """Points of all LiDARs and radars together."""
        return sum(len(m.xyz) for m in self.messages.values() if isinstance(m, PointCloud | RadarScan))

    @property
    def num_pixels(self) -> int:
        """Pixels of all images together."""
        return sum(m.size_wh[0] * m.size_wh[1] for m in self.messages.values() if isinstance(m, Image))


@dataclass(frozen=True)
class Fault:
    """Something wrong with the data of one frame that a pipeline met: a code of the fault table, and where."""

    code: str
    where: str


@dataclass(frozen=True, eq=False)
class Output:
    """What a pipeline makes of one frame: boxes in body coordinates (3D) or in images (2D)."""

    detections: Boxes
    tracks: Boxes | None
    """`None`: the pipeline doesn't track; empty: it does, and follows nothing."""
    stage_ns: Mapping[str, int]
    """Time of each stage [ns], in the order in which they ran."""
    faults: tuple[Fault, ...] = ()
    missing: Mapping[str, str] = field(default_factory=dict)
    """Sensors that the pipeline could have used but couldn't, with the reason: a camera without weights."""
    clock: ClockName = "host"
    """`log` where the pipeline only passes on what was computed elsewhere: then the times of the stages are log times
    that follow the frame's instant and add up to the latency, which is unknown without any; what the step took says
    nothing. Else they are wall times within the step.
    """
    digests: Mapping[str, str] = field(default_factory=dict)
    """Of what single stages gave, in the order in which they come; two runs are compared by them."""
    cpu_ns: Mapping[str, int] = field(default_factory=dict)
    """CPU time of stages [ns], where it is known, of the thread that ran each."""

    def __post_init__(self) -> None:
        kind, other = type(self.detections), type(self.tracks)
        if self.tracks is not None and kind is not other:
            raise DataError(f"Output.tracks: expected {kind.__name__}, got {other.__name__}")
