"""The folder with weights that were fetched: nothing gets there, or is used, that isn't the published file."""

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO, Literal

from fbench.pipelines.weights.catalogue import Entry
from fbench.replay.errors import ConfigError, ModelError
from fbench.replay.user_cache import fbench_cache

State = Literal["absent", "good", "damaged"]
BLOCK_BYTES = 1 << 20


def weights_folder() -> Path:
    """Return where weights are kept: `weights` in fbench's cache.

    Raises:
        ConfigError: where the user has no home folder, and `FBENCH_CACHE` names no other.
    """
    try:
        return fbench_cache() / "weights"
    except RuntimeError as error:
        raise ConfigError(f"no folder for weights ({error}): name one in FBENCH_CACHE") from error


def state(entry: Entry, path: Path) -> State:
    """Tell whether a file is there, and whether it is the published one.

    Raises:
        ModelError: where it can't be read.
    """
    try:
        if not path.is_file():
            return "absent"
        if path.stat().st_size != entry.num_bytes:
            return "damaged"
        with path.open("rb") as file:
            return "good" if hashlib.file_digest(file, "sha256").hexdigest() == entry.sha256 else "damaged"
    except OSError as error:
        raise ModelError(f"{path}: can't be read ({error.strerror or error})") from error


def file_blocks(path: Path) -> Iterator[bytes]:
    """Yield the content of a file.

    Raises:
        ConfigError: where it can't be read.
    """
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK_BYTES):
                yield block
    except OSError as error:
        raise ConfigError(f"{path}: weights can't be read ({error.strerror or error})") from error


def store(entry: Entry, blocks: Iterable[bytes], source: str, target: Path) -> None:
    """Write what comes from `source` to `target`, if it is the published file; what was there before is replaced.

    Raises:
        ModelError: where it isn't, or can't be written; nothing is left behind.
    """
    partial = target.with_name(f".{target.name}.partial-{os.getpid()}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as out:
            _copy(entry, blocks, source, out)
        partial.replace(target)
    except OSError as error:
        raise ModelError(
            f"{target.parent}: {entry.file_name} can't be written there ({error.strerror or error}); "
            "FBENCH_CACHE may name another folder"
        ) from error
    finally:
        with suppress(OSError):  # where the folder can't be written, nothing is there
            partial.unlink(missing_ok=True)


def _copy(entry: Entry, blocks: Iterable[bytes], source: str, out: BinaryIO) -> None:
    digest, num_bytes = hashlib.sha256(), 0
    for block in blocks:
        num_bytes += len(block)
        if num_bytes > entry.num_bytes:
            raise ModelError(f"{source}: longer than the {entry.num_bytes} bytes of {entry.name}, not taken")
        digest.update(block)
        out.write(block)
    if num_bytes < entry.num_bytes:
        raise ModelError(
            f"{source}: ends after {num_bytes} of the {entry.num_bytes} bytes of {entry.name}, fetch it again"
        )
    if digest.hexdigest() != entry.sha256:
        raise ModelError(
            f"{source}: isn't {entry.name} as published, not taken (sha256 {digest.hexdigest()}, "
            f"expected {entry.sha256})"
        )
