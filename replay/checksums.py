"""CRC-32 (ISO 3309, as in zlib, MCAP and Parquet), by ISA-L: at memory speed, so that it can always be checked."""

from isal.isal_zlib import crc32

__all__ = ["crc32"]
