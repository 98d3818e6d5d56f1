"""What a file of boxes held, for the manifest."""

from hashlib import blake2b
from pathlib import Path

from fbench.replay.errors import LogError

_PIECE = 2**20


def digest_of(path: Path) -> str:
    """Return the blake2b-128 of a file; of a folder, over names and digests of all its files in the order of names.

    Raises:
        LogError: where a file can't be read.
    """
    if path.is_file():
        return _digest(path)
    whole = blake2b(digest_size=16)
    for file in sorted(file for file in path.rglob("*") if file.is_file()):
        whole.update(f"{file.relative_to(path).as_posix()}\n{_digest(file)}\n".encode("utf-8", "surrogateescape"))
    return whole.hexdigest()


def _digest(path: Path) -> str:
    found = blake2b(digest_size=16)
    try:
        with path.open("rb") as file:
            while piece := file.read(_PIECE):
                found.update(piece)
    except OSError as error:
        raise LogError(f"{path}: can't be read ({error.strerror})") from error
    return found.hexdigest()
