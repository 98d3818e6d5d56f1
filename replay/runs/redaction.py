"""Redaction: a run that keeps numbers and nothing that tells whose log it is or where it was recorded."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fbench.replay.contracts.plugins import PipelineName, parse_name
from fbench.replay.data.rig import LogInfo
from fbench.replay.runs.digest import digest
from fbench.replay.runs.folder import FrameRecord
from fbench.replay.runs.manifest import Manifest

_NEEDED = re.compile(r"reference|radar\..+|kitti\.camera0")  # Keys of a log's metadata that pipelines and reports read
_FILE = re.compile(r"[/\\]|\w\.[A-Za-z]")  # What texts have in which a file may be named
_REDACTED = "redacted"


def public_id(info: LogInfo) -> str:
    """An id that says which logs are the same, and no more."""
    return digest(info.log_id)


def public_name(info: LogInfo) -> str:
    """A name that says which logs are the same, and no more."""
    return f"log-{public_id(info)[:8]}"


def public_pipeline(text: str) -> str:
    """A pipeline as the command line names it; of a command only the program, without its folder."""
    name = parse_name(text)
    if name.plugin != "exec" or not name.words:
        return text
    return str(PipelineName("exec", Path(name.words[0]).name))


def redact_manifest(manifest: Manifest) -> Manifest:
    """Return a manifest without the name of the log, without files in parameters, and without metadata that aren't
    needed; other files lose their names where it is written.
    """
    log = manifest.log
    metadata = {key: value for key, value in log.metadata.items() if _NEEDED.fullmatch(key)}
    name = public_name(manifest.log_info)
    return manifest.model_copy(
        update={
            "redacted": True,
            "log": log.model_copy(update={"name": name, "log_id": public_id(manifest.log_info), "metadata": metadata}),
            "parameters": {
                key: _parameter(key.rpartition(".")[2], value) for key, value in manifest.parameters.items()
            },
            "variant": None if manifest.variant is None else manifest.variant.model_copy(update={"title": ""}),
        }
    )


def _parameter(key: str, value: Any) -> Any:
    if isinstance(value, Mapping):
        return {k: _parameter(k, v) for k, v in value.items() if k != "file"}
    if isinstance(value, list | tuple):
        return [_parameter(key, item) for item in value]
    if isinstance(value, str) and key == "command":
        return public_pipeline(f"exec:{value}").removeprefix("exec:")
    return _REDACTED if isinstance(value, str) and _FILE.search(value) else value


def redact_record(record: FrameRecord) -> FrameRecord:
    """Return a frame without texts that may name files: of an exception its type is left."""
    missing = {sensor: _REDACTED if _FILE.search(why) else why for sensor, why in record.missing.items()}
    failed = None if record.failed is None else record.failed.partition(":")[0]
    return replace(record, missing=missing, failed=failed)


def redact_rows(rows: Sequence[Mapping[str, object]]) -> list[dict[str, object]]:
    """Return the rows of `faults.json` without the places, which name topics and files."""
    return [{**row, "places": []} for row in rows]
