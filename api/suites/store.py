"""Logs and results on other machines: any place that fsspec knows, such as `s3://...` or a mounted folder."""

import json
import posixpath
import time
from collections.abc import Callable
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeVar

from fbench.api.suites.cells import RUN_SEAL, is_sealed_run, list_files
from fbench.replay.contracts.errors import ConfigError, LogError, MissingPackageError, OutputError
from fbench.replay.data.files import Draft, fbench_cache, file_name
from fbench.replay.runs.secrets import without_secrets

T = TypeVar("T")
_TRIES, _PAUSE_S = 4, 0.5  # Of what fails now and then; the pause doubles


def is_url(text: str) -> bool:
    """Tell whether a text is an address, not a path on this machine."""
    return "://" in text


def open_place(url: str) -> tuple[Any, str]:
    """Return the file system of an address, and the path in it. Raises ConfigError where it can't be used."""
    if find_spec("fsspec") is None:
        raise MissingPackageError(f"{without_secrets(url)}: needs fsspec; pip install 'fbench[cluster]'")
    import fsspec

    try:
        place, path = fsspec.core.url_to_fs(url)
        return place, str(path)
    except (ImportError, ValueError, OSError) as error:
        raise ConfigError(f"{without_secrets(url)}: can't be used ({error})") from error


def find_logs(url: str) -> list[str]:
    """Return the addresses that a pattern fits, sorted; that of a log itself where it is no pattern. Raises ConfigError
    where nothing is there.
    """
    place, path = open_place(url)
    try:
        found = sorted(place.glob(path)) if any(c in path for c in "*?[") else [path] * place.exists(path)
    except OSError as error:
        raise ConfigError(f"{without_secrets(url)}: can't be read ({error})") from error
    if not found:
        raise ConfigError(f"no such log: {without_secrets(url)}")
    return [place.unstrip_protocol(one) for one in found]


def log_place(url: str) -> Path:
    """Return where a log from elsewhere lies on this machine, once it was fetched: in the folder of caches."""
    name = file_name(posixpath.basename(url.rstrip("/")))
    return fbench_cache() / "logs" / blake2b(url.encode(), digest_size=8).hexdigest() / name


def fetch_log(url: str, path: Path) -> Path:
    """Return the path of a log, which is fetched unless it is here and as it is there. Raises LogError where it can't
    be.
    """
    if path.exists() and log_place(url) != path:
        return path
    path = log_place(url)
    place, inside = open_place(url)
    mark = path.with_name(f".{path.name}.from")

    def fetch() -> Path:
        state = str(place.ukey(inside))
        if path.exists() and mark.is_file() and mark.read_text(encoding="utf-8") == state:
            return path
        is_folder = place.isdir(inside)
        with Draft(path, is_folder) as draft:
            place.get(inside.rstrip("/") + "/" if is_folder else inside, str(draft.path), recursive=is_folder)
            draft.publish()
        mark.write_text(state, encoding="utf-8")
        return path

    return _retry(fetch, lambda error: LogError(f"{without_secrets(url)}: can't be fetched ({error})"))


class ResultStore:
    """Run folders by their keys; each is there whole or not at all: its seal is written last. Raises ConfigError where
    the place can't be used.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._place, self._root = open_place(url)

    def fetch(self, key: str, folder: Path) -> bool:
        """Copy a run into a folder on this machine; `False` where there is none of that key, or it is damaged. Raises
        OutputError where the store keeps failing.
        """

        def fetch() -> bool:
            try:
                seal = json.loads(self._place.cat_file(self._path(key, RUN_SEAL)))
                names = [RUN_SEAL, *map(str, seal["files"])]
                if not all(_is_inside(name) for name in names if name != RUN_SEAL):
                    return False
                with Draft(folder, is_folder=True) as draft:
                    for name in names:
                        (draft.path / name).parent.mkdir(exist_ok=True)
                        (draft.path / name).write_bytes(self._place.cat_file(self._path(key, name)))
                    if not is_sealed_run(draft.path, key):
                        return False
                    draft.publish()
            except (FileNotFoundError, ValueError, KeyError, TypeError):
                return False
            return True

        return _retry(fetch, self._error)

    def put(self, key: str, folder: Path) -> None:
        """Keep a sealed run. Raises OutputError where the store keeps failing."""

        def put() -> None:
            if self._place.exists(self._path(key, RUN_SEAL)):
                return
            for name in list_files(folder):
                self._place.makedirs(posixpath.dirname(self._path(key, name)), exist_ok=True)
                self._place.pipe_file(self._path(key, name), (folder / name).read_bytes())
            # Where a store renames, nobody sees half of a seal, either.
            self._place.pipe_file(self._path(key, f"{RUN_SEAL}.partial"), (folder / RUN_SEAL).read_bytes())
            self._place.mv(self._path(key, f"{RUN_SEAL}.partial"), self._path(key, RUN_SEAL))

        _retry(put, self._error)

    def _path(self, *names: str) -> str:
        return "/".join([self._root.rstrip("/"), *names])

    def _error(self, error: Exception) -> OutputError:
        return OutputError(f"store {without_secrets(self.url)} fails ({error})")


def _is_inside(name: str) -> bool:
    """Tell whether a file that a seal names is one of a run, or of a folder in it."""
    parts = name.split("/")
    return len(parts) <= 2 and all(file_name(part) == part and part.strip(".") for part in parts)


def put_log(path: Path, url: str) -> None:
    """Copy a log, a file, to an address, unless one of its size is there. Raises OutputError where that fails."""
    place, inside = open_place(url)

    def put() -> None:
        if not (place.exists(inside) and place.size(inside) == path.stat().st_size):
            place.makedirs(posixpath.dirname(inside), exist_ok=True)
            place.put_file(str(path), f"{inside}.partial")
            place.mv(f"{inside}.partial", inside)

    _retry(put, lambda error: OutputError(f"{without_secrets(url)}: can't be written ({error})"))


def _retry(act: Callable[[], T], error_of: Callable[[Exception], Exception]) -> T:
    """Do what may fail now and then. Raises the error made of the last failure."""
    pause_s = _PAUSE_S
    for attempt in range(_TRIES):
        try:
            return act()
        except OSError as error:  # what fsspec's file systems raise, timeouts included
            if attempt == _TRIES - 1:
                raise error_of(error) from error
            time.sleep(pause_s)
            pause_s *= 2
    raise AssertionError
