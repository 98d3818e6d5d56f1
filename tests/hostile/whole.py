"""Whole commands on damaged logs, configurations and run folders: what they print, their exit code, what they leave."""

import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import chdir, contextmanager
from functools import cache
from pathlib import Path

from mcap.writer import CompressionType
from tests.cli import conftest as logs
from tests.hostile.damage import Random, damage, edit_number, edit_text
from tests.hostile.mcap_logs import NAME, seal
from tests.hostile.target import Case, Files, Found, Target
from tests.replay.logs.other_forms import rewrite

from fbench.cli import main
from fbench.replay.contracts.errors import EXIT_DATA, EXIT_LOSSY, EXIT_NO, EXIT_OK, EXIT_USAGE, DataError

RUN = "run"
_LOG_COMMANDS = ("log info", "log check", "init -o out.toml", "log convert -o out.parquet", "log preview -o out")
_SHARES = (0.25, 0.25, 0.24, 0.24, 0.02)  # Of these: a preview takes 20 times as long as another
_RUN_COMMANDS = ("report run -o out.html", "compare run run", "score run", "report run run -o out.html")
_MEASURED = {"timings.parquet", "latency.json", "host.json"}


@cache
def log() -> bytes:
    """A log of two frames in chunks without compression, with checksums."""
    with tempfile.TemporaryDirectory() as folder:
        plain = logs.write_log(Path(folder) / NAME, [*logs.messages(2), *logs.truths(2)])
        return rewrite(
            plain, Path(folder) / "other.mcap", chunk_size=3000, compression=CompressionType.NONE
        ).read_bytes()


@cache
def configuration() -> bytes:
    """What `init` writes of it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / NAME).write_bytes(log())
        code, said = call(place, "init", NAME, "-o", "fbench.toml")
        assert code == EXIT_OK, said
        return (place / "fbench.toml").read_bytes()


@cache
def run_folder() -> Files:
    """What a replay of it writes."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / NAME).write_bytes(log())
        code, said = call(place, *_replay("radar3d"))
        assert code == EXIT_OK, said
        files = sorted(path for path in (place / RUN).rglob("*") if path.is_file())
        return {str(path.relative_to(place)): path.read_bytes() for path in files}


def _replay(pipeline: str) -> tuple[str, ...]:
    return ("replay", NAME, "-p", pipeline, "-o", RUN, "--overwrite")


def call(folder: Path, *args: str) -> tuple[int, str]:
    """Call `fbench ARGS` in a folder; returns its exit code and what it wrote to stderr."""
    code, kept = EXIT_OK, sys.argv
    with chdir(folder), _output(folder / "stdout", folder / "stderr"):
        sys.argv = ["fbench", *args]
        try:
            main()
        except SystemExit as stop:
            code = int(stop.code or 0)
        finally:
            sys.argv = kept
    return code, (folder / "stderr").read_text()


@contextmanager
def _output(out: Path, err: Path) -> Iterator[None]:
    """Let standard output and error go to files."""
    kept = [(number, os.dup(number)) for number in (1, 2)]
    try:
        for (number, _), path in zip(kept, (out, err), strict=True):
            file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, number)
            os.close(file)
        yield
    finally:
        for stream, (number, copy) in zip((sys.stdout, sys.stderr), kept, strict=True):
            stream.flush()
            os.dup2(copy, number)
            os.close(copy)


def use(folder: Path) -> Found:
    """Call what the case says: an exit code that has a meaning, one line for each error, no draft left behind. A replay
    that says that nothing was lost gives what it gives of the whole log.
    """
    args = json.loads((folder / "args.json").read_text())
    code, said = call(folder, *args)
    assert "Traceback" not in said, said[-300:]
    assert code in (EXIT_OK, EXIT_NO, EXIT_USAGE, EXIT_DATA, EXIT_LOSSY), f"exit code {code}"
    left = [path.name for path in folder.rglob("*") if ".partial" in path.name]
    assert not left, f"left behind: {left}"
    if code in (EXIT_USAGE, EXIT_DATA):
        lines = [line for line in said.splitlines() if line.startswith("fbench: ")]
        assert len(lines) == 1, f"{len(lines)} lines: {said[-300:]}"
        raise DataError(lines[0])
    content: Counter[str] = Counter()
    if args[0] == "replay" and code == EXIT_OK:
        files = sorted(path for path in (folder / RUN).iterdir() if path.suffix == ".parquet")
        content.update(f"{p.name} {p.read_bytes().hex()}" for p in files if p.name not in _MEASURED)
    return Found(content, is_lossy=code == EXIT_LOSSY)


def _case(args: tuple[str, ...], files: Files, whole: Files | None = None) -> Case:
    about = {"args.json": json.dumps(args).encode()}
    return Case({**files, **about}, None if whole is None else {**whole, **about})


def make_replay(random: Random) -> Case:
    """Damage the log, or edit numbers and make the checksums right."""
    args = (*_replay(["lidar3d", "radar3d", "plain3d"][int(random.integers(3))]), *["--json"][: random.integers(2)])
    if random.random() < 0.5:
        return _case(args, {NAME: damage(log(), random)}, {NAME: log()})
    return _case(args, {NAME: seal(log(), edit_number(log(), random))})


def make_configured(random: Random) -> Case:
    """Edit words of the configuration of a log."""
    args = (*_replay("radar3d"), "--config", "fbench.toml")
    return _case(args, {NAME: log(), "fbench.toml": edit_text(configuration(), random)})


def make_log_command(random: Random) -> Case:
    """Damage or edit the log of any command that reads one."""
    name, *rest = str(random.choice(_LOG_COMMANDS, p=_SHARES)).split(" -")
    args = (*name.split(), NAME, *(word for part in rest for word in f"-{part}".split()))
    how = damage(log(), random) if random.random() < 0.5 else seal(log(), edit_number(log(), random))
    return _case(args, {NAME: how})


def make_run_command(random: Random) -> Case:
    """Change bytes, words or numbers of any file of a run folder."""
    whole = run_folder()
    name = sorted(whole)[int(random.integers(len(whole)))]
    how = (
        edit_text
        if name.endswith(".json") and random.random() < 0.7
        else [damage, edit_number][int(random.integers(2))]
    )
    args = tuple(_RUN_COMMANDS[int(random.integers(len(_RUN_COMMANDS)))].split())
    return _case(args, {**whole, name: how(whole[name], random)})


TARGETS = {
    "replay": Target("`replay` of a log, damaged or edited", make_replay, use),
    "replay-config": Target("`replay` with an `fbench.toml`, edited", make_configured, use),
    "log-command": Target(
        "`log info`, `check`, `preview`, `convert` and `init`, log damaged or edited", make_log_command, use
    ),
    "run-command": Target("`report`, `compare` and `score`, files of a run damaged or edited", make_run_command, use),
}
