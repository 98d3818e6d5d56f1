"""MCAP files: damaged in every form, and edited in and around the chunks with their checksums made right again."""

import io
import struct
import tempfile
from collections import Counter, deque
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from functools import cache
from pathlib import Path
from typing import Any
from zlib import crc32

from mcap.opcode import Opcode
from mcap.records import Channel, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer
from tests.hostile.damage import EXTREMES, Random, damage, edit_number, edit_proto, edit_text
from tests.hostile.target import Case, Found
from tests.replay.logs import builders as b
from tests.replay.logs.other_forms import HEAD, NO_SUMMARY, layout, rewrite

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.contracts.faults import UNVERIFIED, FaultLog
from fbench.replay.logs.open import open_log

NAME = "log.mcap"
FORMS: Mapping[str, list[dict[str, Any]]] = {
    "mcap": [{"compression": c} for c in (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD)],
    "mcap-unchunked": [{"use_chunking": False}, {"use_chunking": False, **NO_SUMMARY}],
    "mcap-no-summary": [{"compression": c, **NO_SUMMARY} for c in (CompressionType.NONE, CompressionType.ZSTD)],
    "mcap-no-checksums": [
        {"enable_crcs": False, "enable_data_crcs": False, "compression": CompressionType.NONE},
        {"enable_crcs": False, "enable_data_crcs": False, "use_chunking": False},
    ],
}
_CHUNK_HEAD = 8 + 8 + 8  # Start, end and size, before the checksum


def read(path: Path, is_forged: bool = False) -> Found:
    """All that a log delivers: bytes of messages, description, rig; decoded where the bytes may be others than those
    that were recorded.
    """
    faults = FaultLog()
    reader = open_log(path, faults)
    content: Counter[str] = Counter()
    container = reader.container
    if container.rigs:  # one that has rigs of its own has rows in place of bytes
        entries = reader.everything()
    else:
        entries = ((entry, None) for entry in container.entries(frozenset(container.channels)))
    for entry, event in entries:
        data = bytes(entry.data) if isinstance(entry.data, memoryview) else b.canonical(event)
        content[repr((entry.log_ns, entry.topic, entry.publish_ns, entry.sequence, data))] += 1
    about = repr(b.canonical(reader.info.metadata))
    if is_forged:
        dict(reader.num_messages)
    with nullcontext() if is_forged else suppress(FbenchError):
        about += repr(b.canonical(reader.rig))
        if is_forged or faults.counts[UNVERIFIED]:
            deque(reader.everything(), 0)
            deque(reader.truths(), 0)
    return Found(content, about, faults.num_lost > 0, faults.counts[UNVERIFIED] > 0)


@cache
def form(kind: str, which: int) -> bytes:
    """The bytes of a small log with all kinds of messages in one form."""
    with tempfile.TemporaryDirectory() as folder:
        plain = b.write(Path(folder) / NAME, b.sequence(4, points=10), b.the_rig(), chunk_size=3000)
        return rewrite(plain, Path(folder) / "other.mcap", chunk_size=3000, **FORMS[kind][which]).read_bytes()


def damaged(kind: str, random: Random) -> Case:
    """Bytes are changed, and no checksum is."""
    content = form(kind, int(random.integers(len(FORMS[kind]))))
    return Case({NAME: damage(content, random)}, {NAME: content})


def forged(random: Random) -> Case:
    """Numbers in place, or records before they are written; all checksums are right."""
    if random.random() < 0.4:
        kind = ["mcap", "mcap-unchunked"][int(random.integers(2))]
        return Case({NAME: seal(form(kind, 0), edit_number(form(kind, 0), random))})
    return Case({NAME: write(edit(list(records()), random), random)})


def seal(original: bytes, edited: bytes) -> bytes:
    """Make the checksums right in a file without compression whose numbers were edited in place."""
    data, places = bytearray(edited), layout(original)
    for opcode, at, length in places:
        if opcode == Opcode.CHUNK:
            start = at + HEAD.size + _CHUNK_HEAD + 4 + 4 + 8
            struct.pack_into("<I", data, at + HEAD.size + _CHUNK_HEAD, crc32(data[start : at + length]))
    end = next(at for opcode, at, _ in places if opcode == Opcode.DATA_END)
    struct.pack_into("<I", data, end + HEAD.size, crc32(data[:end]))
    footer = places[-1][1]
    start = struct.unpack_from("<Q", original, footer + HEAD.size)[0]
    if start:
        struct.pack_into("<I", data, footer + HEAD.size + 16, crc32(data[start : footer + HEAD.size + 16]))
    return bytes(data)


@cache
def records() -> tuple[Any, ...]:
    """Schemas, channels, messages and metadata of the small log."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / NAME).write_bytes(form("mcap", 0))
        with (Path(folder) / NAME).open("rb") as file:
            found = list(StreamReader(file).records)
    kept = {(type(r).__name__, r.id): r for r in found if isinstance(r, Schema | Channel)}  # the summary repeats them
    return *kept.values(), *(r for r in found if isinstance(r, Message | Metadata))


def edit(items: list[Any], random: Random) -> list[Any]:
    """Change fields of one to three records."""
    for _ in range(int(random.integers(1, 4))):
        i, j = (int(n) for n in random.integers(0, len(items), 2))
        match items[i]:
            case Schema(id=id_, name=name, encoding=encoding, data=data):
                how = [edit_proto, edit_number, damage][int(random.integers(3))]
                other = items[j].name if isinstance(items[j], Schema) and random.random() < 0.5 else name
                items[i] = Schema(id=id_, name=other, encoding=encoding, data=how(data, random))
            case Channel() as channel:
                metadata = {k: _text(v, random) for k, v in channel.metadata.items()}
                topic = _text(channel.topic, random) if random.random() < 0.3 else channel.topic
                items[i] = Channel(
                    id=channel.id, topic=topic, message_encoding=channel.message_encoding,
                    metadata=metadata, schema_id=int(random.choice([channel.schema_id, 1, 2, 3])),
                )  # fmt: skip
            case Message() as m:
                how = [edit_proto, edit_proto, edit_number, damage][int(random.integers(4))]
                time = EXTREMES[int(random.integers(len(EXTREMES)))] if random.random() < 0.15 else m.log_time
                other = items[j].channel_id if isinstance(items[j], Message) and random.random() < 0.1 else m.channel_id
                items[i] = Message(other, time, how(m.data, random), m.publish_time, m.sequence)
            case Metadata(name=name, metadata=values):
                items[i] = Metadata(name, {k: _text(v, random) for k, v in values.items()})
            case _:
                pass
    return items


def _text(text: str, random: Random) -> str:
    return edit_text(text.encode(), random).decode(errors="replace") if random.random() < 0.5 else text


def write(items: list[Any], random: Random) -> bytes:
    """Write records, in a form that is drawn, too."""
    kind = ["mcap", "mcap", "mcap-unchunked", "mcap-no-summary"][int(random.integers(4))]
    how = {"enable_data_crcs": True, **FORMS[kind][int(random.integers(2))]}
    file = io.BytesIO()
    writer = Writer(file, chunk_size=3000, **how)
    writer.start()
    ids: dict[int, int] = {}
    for item in items:
        if isinstance(item, Metadata):
            writer.add_metadata(item.name, item.metadata)
        elif isinstance(item, Schema):
            ids[item.id] = writer.register_schema(item.name, item.encoding, item.data)
    for item in items:
        if isinstance(item, Channel):
            writer.register_channel(item.topic, item.message_encoding, ids.get(item.schema_id, 0), item.metadata)
    for item in items:
        if isinstance(item, Message):
            writer.add_message(item.channel_id, item.log_time, item.data, item.publish_time, item.sequence)
    writer.finish()
    return file.getvalue()
