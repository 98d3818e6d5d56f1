"""Opening what a conversion writes to."""

from pathlib import Path

from fbench.replay.data import LogInfo
from fbench.replay.logs.convert.parts import PartsWriter
from fbench.replay.logs.convert.sinks import McapSink, ParquetSink, Sink
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.header import LogHeader
from fbench.replay.logs.mcap.raw_write import RawMcapWriter
from fbench.replay.logs.parquet.write import ParquetWriter

_CHUNK = 1024 * 1024


def open_sink(target: Target, about: LogHeader) -> Sink:
    """Begin to write a log.

    Raises:
        ConfigError: where it can't be written, or not with this compression.
        LogError: where its metadata aren't Unicode.
    """
    compression = target.compression or "zstd"
    if target.form == "parquet":
        info = LogInfo(target.path.stem, about.log_id, about.metadata)
        return ParquetSink(ParquetWriter(target.path, info, None, compression, target.rows_per_group, about.kinds))

    def open_file(path: Path) -> RawMcapWriter:
        return RawMcapWriter(path, about, compression, target.chunk_size or _CHUNK)

    if target.split is None:
        return McapSink(open_file(target.path), str(target.path))
    parts = PartsWriter(target.path, target.split, open_file)
    return McapSink(parts, str(target.path), parts.names)
