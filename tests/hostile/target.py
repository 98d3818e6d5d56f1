"""A target of the fuzzing: how its cases are made from a seed, how one is used, and what that may come to."""

import io
import json
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from tests.hostile.damage import Random

Files = Mapping[str, bytes]


@dataclass(frozen=True)
class Case:
    """Files to be opened. `whole`: as they were before they were damaged; `None`: they were edited with their
    checksums, as whoever means harm does, so that what they say counts.
    """

    files: Files
    whole: Files | None = None

    def write(self, folder: Path, files: Files | None = None) -> None:
        """Write the files, or those given, into an empty folder."""
        for name, content in (self.files if files is None else files).items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).write_bytes(content)

    def pack(self, kind: str) -> bytes:
        """Return the case as the corpus has it: a zip file of the same bytes each time."""
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for part, files in (("files", self.files), ("whole", self.whole or {})):
                for name, content in sorted(files.items()):
                    archive.writestr(zipfile.ZipInfo(f"{part}/{name}"), content, zipfile.ZIP_DEFLATED)
            archive.writestr(zipfile.ZipInfo("case.json"), json.dumps({"kind": kind}))
        return file.getvalue()


def unpack(path: Path) -> tuple[str, Case]:
    """Return kind and case of a file of the corpus."""
    with zipfile.ZipFile(path) as archive:
        parts: dict[str, dict[str, bytes]] = {"files": {}, "whole": {}}
        for name in archive.namelist():
            part, _, rest = name.partition("/")
            if rest:
                parts[part][rest] = archive.read(name)
        kind = json.loads(archive.read("case.json"))["kind"]
    return kind, Case(parts["files"], parts["whole"] or None)


@dataclass(frozen=True)
class Found:
    """What the files hold: all that is delivered, what is said about it, whether a loss was counted, and whether it was
    said that damage would go unnoticed.
    """

    content: Counter[str] = field(default_factory=Counter)
    about: str = ""
    is_lossy: bool = False
    is_unverified: bool = False


OUTCOMES = {
    "equal": "as before the damage",
    "counted": "loss counted",
    "flagged": "changed, flagged as unverified",
    "refused": "refused in one line",
    "read": "edited, read",
}
FINDINGS = ("silent", "error", "memory", "time", "crash")


@dataclass(frozen=True)
class Target:
    """One kind of input. `use` gets a folder with the files of a case and does with them what fbench would."""

    what: str  # In the table: what is made, and what is done to it
    make: Callable[[Random], Case]
    use: Callable[[Path], Found]

    def judge(self, found: Found, whole: Found | None) -> tuple[str, str]:
        """Return the outcome of a case that was read, and what is wrong where it is a finding."""
        if whole is None:
            return "read", ""
        if (found.content, found.about) == (whole.content, whole.about):
            return "equal", ""
        if found.content - whole.content and not found.is_unverified:
            wrong = sum((found.content - whole.content).values())
            return "silent", f"{wrong} messages that aren't in the log"
        if found.is_lossy:
            return "counted", ""
        if found.is_unverified:
            return "flagged", ""
        missing = sum((whole.content - found.content).values())
        return "silent", f"{missing} messages missing, or another description, and no fault is counted"
