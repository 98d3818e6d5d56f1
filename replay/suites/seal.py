"""Seals: beside what took long to make, what it was made from, and digests that tell whether it is still whole."""

import json
from collections.abc import Mapping
from pathlib import Path

from fbench.replay.boxfiles.digest import digest_of
from fbench.replay.errors import LogError
from fbench.replay.files import replace_text

RUN_SEAL = "cell.json"
"""In a run folder; holds what the run was made from, too."""


def seal_run(folder: Path, key: str, content: Mapping[str, object]) -> None:
    """Note that a run folder is whole, and what it was made from."""
    files = {file.name: digest_of(file) for file in sorted(folder.iterdir()) if file.is_file()}
    files.pop(RUN_SEAL, None)
    text = json.dumps({"key": key, "made_from": content, "files": files}, indent=1, sort_keys=True)
    replace_text(folder / RUN_SEAL, text + "\n")


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
