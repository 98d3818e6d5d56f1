"""What importers give, as items of a log."""

from collections.abc import Iterator
from dataclasses import replace

from fbench.replay.data import RigChange, Truth
from fbench.replay.imports.imported import Imported, OtherResult
from fbench.replay.logs.container import Entry
from fbench.replay.logs.convert.encode import Encoded, Encoder
from fbench.replay.logs.convert.items import Copied, Decoded, Item, RigAt
from fbench.replay.logs.foxglove.topics import BOXES2D, BOXES3D, message_topic
from fbench.replay.logs.truth_part import TruthPart


class LogItems:
    """Turns what importers give into items of a log."""

    def __init__(self) -> None:
        self._encoder = Encoder()

    def of(self, imported: Imported) -> Iterator[Item]:
        """Return the items that hold one message, truth, result or rig.

        Raises:
            ValueError: where a result can't be stored.
        """
        match imported:
            case RigChange():
                yield RigAt(imported.log_ns, imported.rig)
            case Truth():
                for part in _parts(imported):
                    yield Decoded(BOXES2D if part.is_2d else BOXES3D, imported.log_ns, part)
            case OtherResult():
                for part in _parts(imported.boxes):
                    # A topic without any box would be taken for the results where there are only those in images.
                    if part.is_2d or part.truth.boxes3d is not None:
                        yield _copied(self._encoder.result(part), imported.boxes.log_ns)
            case _:
                yield Decoded(message_topic(imported), imported.log_ns, imported)


def _parts(truth: Truth) -> Iterator[TruthPart]:
    """3D boxes first, also where they are absent, which says that 2D ones follow."""
    has_2d = truth.boxes2d is not None
    yield TruthPart(replace(truth, boxes2d=None), is_2d=False, expects_2d=has_2d)
    if has_2d:
        yield TruthPart(replace(truth, boxes3d=None), is_2d=True)


def _copied(encoded: Encoded, log_ns: int) -> Copied:
    channel, data = encoded.channel, memoryview(encoded.data)
    entry = Entry(log_ns, channel.topic, 0, 0, 0, 0, encoded.sequence, encoded.publish_ns, data)
    return Copied(channel, entry)
