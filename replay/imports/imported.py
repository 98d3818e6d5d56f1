"""What a recording of a dataset consists of."""

from dataclasses import dataclass

from fbench.replay.data import Message, RigChange, Truth


@dataclass(frozen=True, eq=False)
class OtherResult:
    """What another system made of one instant; the pipeline `recorded` reads it."""

    boxes: Truth
    """In body coordinates; 3D and 2D boxes go onto topics of their own."""


Imported = Message | Truth | OtherResult | RigChange
