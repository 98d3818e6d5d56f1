"""Messages that rosbag2 compressed one by one."""

from pathlib import Path

import zstandard

from fbench.replay.contracts.errors import LogError
from fbench.replay.logs.containers.mcap.records import MAX_RECORD, RecordError

_PIECE = 1024 * 1024
_MAGIC = b"\x28\xb5\x2f\xfd"  # RFC 8878, section 3.1.1
_MAX_WINDOW = 128 * 1024 * 1024


def require_plain(path: Path, start: bytes) -> None:
    """Refuse a file that begins as zstd does: it is compressed as a whole. Raises LogError saying what undoes it."""
    if start.startswith(_MAGIC):
        raise LogError(f"{path}: compressed as a whole; decompress it first (`unzstd {path.name}`)", "LOG007")


def check_format(path: Path, compression: str) -> None:
    """Refuse a compression of messages that can't be undone. Raises LogError naming file and compression."""
    if compression not in ("", "zstd"):
        raise LogError(f"{path}: unknown message compression '{compression}'; fbench reads zstd and none", "LOG007")


def is_packed(data: memoryview, encoding: str) -> bool:
    """Tell whether a message of an encoding was compressed, where nothing says so: CDR never begins like zstd."""
    return encoding == "cdr" and data[:4] == _MAGIC


def unpack_message(data: memoryview) -> memoryview:
    """Decompress a message; allocates little beyond `MAX_RECORD`. Raises RecordError where it is damaged or larger."""
    try:
        size = zstandard.frame_content_size(data)
        if size > MAX_RECORD:
            raise RecordError(f"message has {size} unpacked bytes, more than the limit of {MAX_RECORD}")
        if size >= 0:
            return memoryview(zstandard.ZstdDecompressor().decompress(data))
        buffer = bytearray()  # it doesn't tell its size
        with zstandard.ZstdDecompressor(max_window_size=_MAX_WINDOW).stream_reader(data) as reader:
            while piece := reader.read(_PIECE):
                if len(buffer) + len(piece) > MAX_RECORD:
                    raise RecordError(f"message has more than {MAX_RECORD} unpacked bytes")
                buffer += piece
        return memoryview(buffer)
    except (zstandard.ZstdError, MemoryError) as error:
        raise RecordError(f"zstd data are damaged ({error})") from error
