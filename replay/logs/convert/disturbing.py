"""Items of a conversion under conditions, for a disturbed log that can be given to others."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from hashlib import blake2b

from fbench.replay.conditions.disturb import Disturbance, Disturber, in_order_of_delivery
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.steps import RAW
from fbench.replay.data.images import LAYOUTS, decode, encode_png
from fbench.replay.data.messages import Image, Message, Pose, Tick
from fbench.replay.data.rig import RigChange
from fbench.replay.data.video import CODECS
from fbench.replay.logs.codecs.codec import TruthPart
from fbench.replay.logs.container import LogHeader
from fbench.replay.logs.convert.sinks import Copied, Decoded, Item, RigAt
from fbench.replay.logs.reader import LogReader


def disturb_header(about: LogHeader, disturbance: Disturbance) -> LogHeader:
    """Return what the disturbed log says about itself: another id, and `conditions` and `conditions.seed`."""
    ids = [part.id for part in disturbance.parts]
    conditions = "+".join(map(str, disturbance.parts))
    text = "|".join([about.log_id, str(disturbance.seed), *ids, conditions])
    before = f"{found}+" if (found := about.metadata.get("conditions")) else ""
    told = {"conditions": before + conditions, "conditions.seed": str(disturbance.seed)}
    log_id = f"{about.log_id}-{blake2b(text.encode(), digest_size=8).hexdigest()}"
    return replace(about, log_id=log_id, metadata={**about.metadata, **told})


def disturb(items: Iterable[Item], reader: LogReader, disturbance: Disturbance, effects: Effects) -> Iterator[Item]:
    """Yield the items of a whole log in the order in which they are delivered under conditions; images that changed are
    stored as PNG, without loss. Rigs are those that pipelines are given. Raises ConfigError and LogError as
    `Disturbance.require_fits` does.
    """
    disturbance.require_fits(reader.rig)
    disturber = Disturber(reader, disturbance, effects)
    disturbed = frozenset(disturbance.steps(reader.rig))

    def apply(item: Item) -> Iterator[Item]:
        if isinstance(item, RigAt):
            list(disturber.disturb(RigChange(item.log_ns, item.rig, ())))
            given = disturbance.rig(item.rig, reader.info.log_id)
            effects.add_rig(item.rig, given)
            yield item._replace(rig=given)
        elif isinstance(item, Copied) or isinstance(item.content, TruthPart | Pose):
            yield item
        else:
            for message in disturber.disturb(item.content):
                if not isinstance(message, Tick | RigChange):
                    stored = _store(item.content, message) if message.sensor in disturbed else message
                    yield Decoded(item.topic, message.log_ns, stored)

    known = disturber.look_ahead(items, _log_ns, lambda item: item.content if isinstance(item, Decoded) else None)
    return in_order_of_delivery(known, apply, _log_ns)


def _log_ns(item: Item) -> int:
    return item.entry.log_ns if isinstance(item, Copied) else item.log_ns


def _store(recorded: Message, message: Message) -> Message:
    """Return a disturbed image as PNG where it was compressed, so that a topic keeps its schema; pictures of a video
    too, of which others may be missing now.
    """
    if not (isinstance(message, Image) and isinstance(recorded, Image)):
        return message
    is_new = message.encoding == RAW and recorded.encoding not in LAYOUTS
    if not is_new and message.encoding not in CODECS:
        return message
    pixels = decode(message)
    return message if pixels is None else replace(message, data=encode_png(pixels), encoding="png", video=None)
