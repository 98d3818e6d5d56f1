"""Writing files so that nobody ever sees half of one, safe names for them, and the folder of caches."""

import os
import shutil
from hashlib import blake2b
from pathlib import Path

from platformdirs import user_cache_path


def fbench_cache() -> Path:
    """Return the folder of caches: `$FBENCH_CACHE`, else the user's. Raises RuntimeError without a home folder."""
    given = os.environ.get("FBENCH_CACHE", "")
    return Path(given).expanduser().absolute() if given else user_cache_path("fbench", appauthor=False)


def replace_text(path: Path, text: str) -> None:
    """Write a text file, in UTF-8 whatever the locale says, under a temporary name beside it, then rename it."""
    partial = path.with_name(f".{path.name}.partial-{os.getpid()}")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def is_file(path: Path) -> bool:
    """Tell whether a path leads to a regular file; unlike pathlib, also of names that no file can have."""
    return os.path.isfile(path)


def expand_user(text: str) -> Path:
    """Return the path that a user wrote, with `~` and `~USER` replaced where there is such a home folder."""
    try:
        return Path(text).expanduser()
    except RuntimeError:
        return Path(text)


def swap(new: Path, path: Path) -> None:
    """Rename `new` to `path`, in place of a folder that is there; at no moment is there half of either."""
    old = new.with_name(f"{new.name}.old")
    if path.exists():
        path.rename(old)
    new.rename(path)
    sync(path.parent)
    shutil.rmtree(old, ignore_errors=True)


def sync(path: Path) -> None:
    """Have a file or folder written to the disk."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


_MAX_BYTES = 180  # File systems take 255, and what is being written has a longer name


def file_name(name: str) -> str:
    """Return a name without a suffix, at most 180 bytes: anything but letters, digits and `._-+` becomes `_`, and so
    does a point at the beginning: such files are hidden, or are folders.
    """
    text = "".join(c if c.isalnum() or c in "._-+" else "_" for c in name)
    text = f"_{text[1:]}" if text.startswith(".") or not text else text
    return text if len(text.encode()) <= _MAX_BYTES else with_digest(text, name)


def with_digest(text: str, name: str) -> str:
    """Return the name `text` of a file with a digest of `name` behind it, at most 180 bytes."""
    digest = blake2b(name.encode(errors="surrogatepass"), digest_size=4).hexdigest()
    short = text.encode()[: _MAX_BYTES - 1 - len(digest)].decode(errors="ignore")
    return f"{short}-{digest}"
