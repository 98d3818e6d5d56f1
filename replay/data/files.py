"""Writing files so that nobody ever sees half of one, safe names for them, and the folder of caches."""

import errno
import fcntl
import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from hashlib import blake2b
from pathlib import Path
from typing import Self

from platformdirs import user_cache_path

from fbench.replay.contracts.errors import BusyError, output_error


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


class Draft:
    """A file or folder that is written under a temporary name beside `target`, `.NAME.partial`, by one process at a
    time, until `publish` gives it its own name. A `with` block discards at its end what wasn't published.

    The lock lies on the draft itself, so that the system releases it when a process ends, however it ends. The next
    draft of the same target puts back what a killed process was about to replace, and removes what it left. Missing
    parent folders are made. Raises ConfigError, here and in `publish`, where nothing can be written or another process
    writes the same target.
    """

    def __init__(self, target: Path, is_folder: bool = False) -> None:
        self.path = (whole := target.resolve()).with_name(f".{whole.name}.partial")
        self._given, self._target, self._is_folder = target, whole, is_folder
        self._old = self.path.with_name(f"{self.path.name}.old")  # what `publish` replaces, for a moment
        with self._explain():
            make_folder(whole.parent)
            while (number := self._lock()) is None:
                pass
            self._number: int | None = number
            self._settle()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.discard()

    def publish(self) -> None:
        """Give the draft its name, in place of what has it; at no moment is there half of either."""
        with self._explain():
            sync(self.path)
            if self._is_folder and self._target.exists():
                self._target.rename(self._old)
            self.path.replace(self._target)
            sync(self._target.parent)
            self._settle()
            self._close()

    def discard(self) -> None:
        """Leave nothing behind; does nothing after `publish`."""
        if self._number is not None:
            self._settle()  # before the draft's name is free: then the next writer may be replacing the target
            remove(self.path)
            self._close()

    def _lock(self) -> int | None:
        """Open an empty draft that nobody else has, or return `None` where another attempt is due."""
        try:
            number = os.open(self.path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
        except FileNotFoundError:
            with suppress(FileExistsError):
                if self._is_folder:
                    self.path.mkdir()
                else:
                    self.path.touch(exist_ok=False)
            return None
        is_mine = False
        try:
            fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
            with suppress(FileNotFoundError):  # whoever had the lock may have published or removed it by now
                if os.path.samestat(status := os.fstat(number), self.path.lstat()):
                    is_folder = stat.S_ISDIR(status.st_mode)
                    is_empty = not (os.listdir(self.path) if is_folder else status.st_size)
                    if is_mine := is_empty and is_folder == self._is_folder:
                        return number
                    remove(self.path)
        except BlockingIOError:
            why = f"{self._given}: another process is writing it; try again when it has finished"
            raise BusyError(why) from None
        finally:
            if not is_mine:
                os.close(number)
        return None

    @contextmanager
    def _explain(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise output_error(self._given, error) from error

    def _settle(self) -> None:
        if self._old.exists() and not self._target.exists():
            self._old.rename(self._target)
        remove(self._old)

    def _close(self) -> None:
        if self._number is not None:
            os.close(self._number)
            self._number = None


def make_folder(path: Path) -> None:
    """Make a folder with its parents, unless it is there. Raises OSError with the reason where it can't be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), str(path)) from None


def make_parent(path: Path) -> None:
    """Make the folder of a file that is to be written. Raises ConfigError where it can't be."""
    try:
        make_folder(path.absolute().parent)
    except OSError as error:
        raise output_error(path, OSError(error.errno, f"{error.strerror}: {error.filename}")) from error


def remove(path: Path) -> None:
    """Delete a file or a folder, as far as the system lets us; nothing is fine, too."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink()


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
