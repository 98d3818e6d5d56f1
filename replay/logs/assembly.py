"""Assembly of measurements from the messages of channels that send each in many parts, such as packets of a LiDAR."""

from collections.abc import Iterable

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.messages import Message
from fbench.replay.logs.codecs.codec import Assembler, Codec, Origin

NUM_SAMPLED = 1500  # Messages that tell how many make a measurement


class Assembly:
    """The measurements that are on their way, on one pass over a log."""

    def __init__(self) -> None:
        self._assemblers: dict[int, Assembler | None] = {}

    def message(self, channel: int, codec: Codec, kind: str, data: memoryview, origin: Origin) -> Message | None:
        """Decode a message; `None` where it is a part of a measurement that isn't whole yet. Raises DecodeError where
        it is damaged.
        """
        if channel not in self._assemblers:
            self._assemblers[channel] = codec.assembler()
        assembler = self._assemblers[channel]
        return codec.message(kind, data, origin) if assembler is None else assembler.take(data, origin)


def count_parts(assembler: Assembler, messages: Iterable[tuple[memoryview, Origin]]) -> float:
    """Return how many messages, given from a channel's first one on, make a measurement on average; 1 where none is
    whole.
    """
    taken, last, num_whole = 0, 0, 0
    for data, origin in messages:
        taken += 1
        try:
            if assembler.take(data, origin) is not None:
                num_whole, last = num_whole + 1, taken
        except (DecodeError, DataError):
            continue
        if taken == NUM_SAMPLED:
            break
    return max(last / num_whole, 1.0) if num_whole else 1.0
