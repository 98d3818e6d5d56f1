"""Cells of a suite, responses of the processes that replay them, and seals that tell whether a result is valid."""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TextIO, TypeAlias

from pydantic import TypeAdapter

from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.files import replace_text
from fbench.replay.formats.text import digest_of
from fbench.replay.setup.request import ReplayRequest

_STDOUT, _STDERR = 1, 2


@contextmanager
def own_stdout() -> Iterator[TextIO]:
    """Give what writes to this process's stdout, in UTF-8; what else goes there, from libraries and programs too, goes
    to stderr from here on.
    """
    sys.stdout.flush()
    with os.fdopen(os.dup(_STDOUT), "w", encoding="utf-8", errors="backslashreplace") as out:
        os.dup2(_STDERR, _STDOUT)
        with redirect_stdout(sys.stderr):
            yield out


State: TypeAlias = Literal["replayed", "there", "unfit", "failed"]


def folder_of(cell: ReplayRequest) -> Path:
    """Return the folder of a cell's run. Raises ConfigError where the request names none."""
    if cell.out is None:
        raise ConfigError(f"{cell.log.path} through {cell.pipeline}: a cell of a suite needs a folder for its run")
    return cell.out


@dataclass(frozen=True)
class Response:
    """What a process says of a cell; travels as JSON."""

    error: str | None = None  # Why there is no run, in one line
    unfit: bool = False  # Because the log lacks a sensor that the pipeline needs


RESPONSE = TypeAdapter(Response)  # As JSON on one line, for another process


@dataclass(frozen=True)
class CellResult:
    """What became of a cell."""

    cell: ReplayRequest
    state: State  # `replayed` now, or `there` from an earlier time; `unfit`: the log lacks what the pipeline needs
    reason: str | None = None  # Why there is no run; one line
    key: str | None = None  # Of all that the run is made of; `None` where nobody can tell, or it wasn't found out

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return folder_of(self.cell)

    @property
    def has_run(self) -> bool:
        """Whether the run folder is there and whole."""
        return self.state in ("replayed", "there")


CELLS, SCORES = "cells.parquet", "scores.parquet"  # Tables in a suite's folder
RUN_SEAL = "cell.json"  # In a run folder; holds what the run was made from, too


def seal_run(folder: Path, key: str, content: Mapping[str, object]) -> None:
    """Note that a run folder is whole, and what it was made from."""
    files = {name: digest_of(folder / name) for name in list_files(folder)}
    text = json.dumps({"key": key, "made_from": content, "files": files}, indent=1, sort_keys=True)
    replace_text(folder / RUN_SEAL, text + "\n")


def list_files(folder: Path) -> list[str]:
    """Return the files of a run that its seal is about, by their paths inside it; one with latency has a folder."""
    found = sorted(file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file())
    return [name for name in found if name != RUN_SEAL]


def is_sealed_run(folder: Path, key: str) -> bool:
    """Tell whether a run of this key is there, with every file as it was when it was sealed."""
    seal = _read(folder / RUN_SEAL)
    files = seal.get("files")
    if seal.get("key") != key or not isinstance(files, dict) or not files:
        return False
    return all(_is(folder / str(name), digest) for name, digest in files.items())


def seal_log(log: Path, log_id: str) -> None:
    """Note that a log is whole."""
    replace_text(_beside(log), json.dumps({"log_id": log_id, "digest": digest_of(log)}) + "\n")


def is_sealed_log(log: Path, log_id: str) -> bool:
    """Tell whether a log of this id is there, byte for byte as it was when it was sealed."""
    seal = _read(_beside(log))
    return seal.get("log_id") == log_id and log.exists() and _is(log, seal.get("digest"))


def was_sealed(log: Path) -> bool:
    """Tell whether a log was made here, whatever it is now."""
    return _beside(log).is_file()


def _beside(log: Path) -> Path:
    return log.with_name(f".{log.name}.seal")


def _read(path: Path) -> dict[str, object]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):  # absent or damaged: then nothing is known
        return {}
    return content if isinstance(content, dict) else {}


def _is(path: Path, digest: object) -> bool:
    try:
        return digest_of(path) == digest
    except LogError:
        return False
