"""Kill commands at random instants, fill their disk, and take the right to write from their folder, in the middle.

`python -m tests.hostile.interrupt --kills 200 --full 50 --locked 50` goes on where the last run ended, until so many
were interrupted while they ran. It says what was tried and what went wrong, and keeps the numbers in `interrupts.json`,
for docs/faults.md; exit code 1 where something did.
"""

import argparse
import ctypes
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from tests.hostile.commands import COMMANDS, Command, can_contain, prepare, run
from tests.hostile.damage import Random
from tests.hostile.run import FINISHED, INTERRUPTS, PAGE, TALLY, num_running, page, read_counts

from fbench.replay.conditions.generators import generator
from fbench.replay.data.files import replace_text

_PACE = {"replay": 6, "convert": 5, "import": 5, "report": 5, "demo": 1, "bench": 1}  # How often each has its turn
_LIBC = ctypes.CDLL(None, use_errno=True)
_DAC_OVERRIDE = 1  # The capability by which root writes where nobody may
_VERSION = 0x20080522  # Of capset(2)


@dataclass
class Trial:
    """A folder in which commands are interrupted, how long each takes, and what it makes of it undisturbed."""

    folder: Path
    wanted: dict[str, Mapping[str, str]] = field(default_factory=dict)
    taken_s: dict[str, float] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)

    def learn(self, names: list[str]) -> None:
        """Run each undisturbed, twice: code is compiled the first time."""
        for name in names:
            for _ in range(2):
                place = self.empty()
                code = self.run_whole(name, place)
                assert code == 0, f"{name}: {code}: {self.stderr()}"
            self.wanted[name] = COMMANDS[name].digest(place)
            shutil.copytree(place, self.folder / "kept" / name)
            assert self.wanted[name], name

    def run_whole(self, name: str, place: Path) -> int:
        """Run a command undisturbed; how long it takes now says when the next is disturbed, on a busy machine, too."""
        start = time.monotonic()
        code = run(COMMANDS[name], place).wait()
        self.taken_s[name] = time.monotonic() - start
        return code

    def empty(self) -> Path:
        """An empty folder beside what the commands read."""
        place = self.folder / "work"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        return place

    def stderr(self) -> str:
        """What the last command said."""
        return (self.folder / "work.stderr").read_text(errors="replace")

    def say(self, name: str, number: int, what: str) -> None:
        """Note what is wrong."""
        self.wrong.append(f"{name} {number}: {what}")
        sys.stdout.write(f"{self.wrong[-1]}\n  {self.stderr()[-400:]!r}\n")
        sys.stdout.flush()

    def finish(self, name: str, number: int, place: Path) -> None:
        """The command works without a hand, and makes what it makes undisturbed."""
        code = self.run_whole(name, place)
        if code:
            self.say(name, number, f"the next command ends with {code}")
        elif COMMANDS[name].digest(place) != self.wanted[name]:
            self.say(name, number, "the next command gives something else")
        if left := [path.name for path in place.rglob("*") if ".partial" in path.name]:
            self.say(name, number, f"left behind: {left}")

    def require_whole(self, name: str, number: int, place: Path, was_there: bool) -> None:
        """What is there under its own name is whole; what was finished before is there."""
        command: Command = COMMANDS[name]
        found = command.digest(place)
        half = {path for path, digest in found.items() if self.wanted[name].get(path) != digest}
        if half:
            self.say(name, number, f"not whole: {sorted(half)[:3]}")
        if not command.has_parts and found and found.keys() != self.wanted[name].keys():
            self.say(name, number, f"half of it is there: {sorted(found)[:3]}")
        if was_there and not found and not list(place.glob(".*.old")):
            self.say(name, number, "what was there is gone")


_KILLED = (-signal.SIGKILL, 128 + signal.SIGKILL)


def kill(trial: Trial, name: str, number: int, random: Random) -> bool:
    """Kill a command, alone or with all that it started, now and then in a namespace of its own; `False` where it had
    finished before.
    """
    place, was_there = trial.empty(), bool(random.integers(2)) and COMMANDS[name].replaces
    if was_there:
        shutil.copytree(trial.folder / "kept" / name, place, dirs_exist_ok=True)
    is_contained = bool(random.integers(2)) and can_contain()
    child = run(COMMANDS[name], place, is_contained)
    if not child.ends_within(float(random.uniform(0, trial.taken_s[name]))):
        with suppress(ProcessLookupError):  # it may end just now
            if bool(random.integers(2)) and not is_contained:
                os.killpg(child.number, signal.SIGKILL)
            else:
                os.kill(child.command, signal.SIGKILL)
    is_killed = child.wait() in _KILLED
    if is_killed:
        trial.counts[f"{'in a namespace' if is_contained else 'plainly'} killed"] += 1
    trial.require_whole(name, number, place, was_there)
    trial.finish(name, number, place)
    return is_killed


def disturb(trial: Trial, name: str, number: int, random: Random, how: Callable[[Path], object]) -> bool:
    """Let a command run into what `how` does at some instant: one line, 3 or 4, and what was there stays; `False` where
    it had finished before.
    """
    place = trial.folder / "work"
    was_there = bool(random.integers(2)) and COMMANDS[name].replaces
    if was_there:
        shutil.copytree(trial.folder / "kept" / name, place, dirs_exist_ok=True)
    wait_s = float(random.choice([0, random.uniform(0, trial.taken_s[name])]))
    if wait_s == 0:
        how(place)
    child = run(COMMANDS[name], place, before=drop_override)
    is_running = wait_s == 0 or not child.ends_within(wait_s)
    if wait_s and is_running:
        how(place)
    code, said = child.wait(), trial.stderr()
    lines = [line for line in said.splitlines() if line.startswith("fbench: ")]
    if is_running:
        trial.counts["finished all the same" if code == 0 else "refused"] += 1
    if code not in (0, 3, 4):
        trial.say(name, number, f"exit code {code}")
    if (code and len(lines) != 1 and name not in ("demo", "bench")) or "Traceback" in said:
        trial.say(name, number, "isn't told in one line")
    trial.require_whole(name, number, place, was_there)
    return is_running


def drop_override() -> None:
    """Give up the right of root to write anywhere."""
    head = (ctypes.c_uint32 * 2)(_VERSION, 0)
    sets = (ctypes.c_uint32 * 6)()
    _LIBC.capget(head, sets)
    for i in range(3):
        sets[i] &= ~(1 << _DAC_OVERRIDE)
    _LIBC.capset(head, sets)


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[bool]:
    """A disk of its own at `folder/work`; says whether that is permitted."""
    place = folder / "work"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    how = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(place)]
    is_mounted = subprocess.run(how, capture_output=True).returncode == 0
    try:
        yield is_mounted
    finally:
        if is_mounted:
            subprocess.run(["umount", str(place)], check=True)


def fill(trial: Trial, name: str, number: int, random: Random) -> bool:
    """A disk that is full, or becomes so; `False` where the command had finished before."""
    with small_disk(trial.folder, 64 * 2**20) as is_permitted:
        if not is_permitted:
            trial.counts["skipped: no file system may be mounted"] += 1
            return True

        def take_all(place: Path) -> None:
            free = os.statvfs(place)
            rest = int(random.integers(0, 40_000)) if random.integers(2) else 0
            with suppress(OSError), (place / "filler").open("wb") as file:  # the command may take the last of it
                for _ in range(max(0, free.f_bavail * free.f_frsize - rest) // 4096):
                    file.write(bytes(4096))

        is_running = disturb(trial, name, number, random, take_all)
        (trial.folder / "work" / "filler").unlink(missing_ok=True)
        trial.finish(name, number, trial.folder / "work")
        return is_running


def lock(trial: Trial, name: str, number: int, random: Random) -> bool:
    """Folders in which nothing may be written any more; `False` where the command had finished before."""
    place = trial.empty()

    def take_right(place: Path) -> None:
        for path in (place, *place.rglob("*")):
            try:
                if path.is_dir():
                    path.chmod(0o555)
            except FileNotFoundError:  # gone by now
                pass

    is_running = disturb(trial, name, number, random, take_right)
    for path in (place, *place.rglob("*")):
        if path.is_dir():
            path.chmod(0o755)
    trial.finish(name, number, place)
    return is_running


HOW: Mapping[str, Callable[[Trial, str, int, Random], bool]] = {"kills": kill, "full": fill, "locked": lock}


Done = dict[str, dict[str, int]]


def attempt(wanted: Mapping[str, int], names: list[str], seed: int, kept: Done, keep: Callable[[Done], object]) -> Done:
    """Interrupt commands until so many were each way while they ran, those counted in `kept` among them; returns
    counts, which `keep` is given after each time, too.
    """
    done: Done = {}
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial(Path(folder))
        prepare(trial.folder)
        trial.learn(names)
        turns = [name for name in names for _ in range(_PACE[name])]
        for how, num in wanted.items():
            trial.counts, known_wrong = Counter(kept.get(how, {})), kept.get(how, {}).get("wrong", 0)
            trial.wrong.clear()
            while num_running(trial.counts) < num:
                number = sum(trial.counts[name] for name in COMMANDS)
                random = generator(seed + number, "interrupt", how)
                name = turns[int(random.integers(len(turns)))]
                is_running = HOW[how](trial, name, number, random)
                trial.counts += Counter({name: 1, FINISHED: not is_running})
                done[how] = {**dict(sorted(trial.counts.items())), "wrong": known_wrong + len(trial.wrong)}
                keep(done)
        return done


def main() -> int:
    """Interrupt, and keep the numbers."""
    parser = argparse.ArgumentParser(description=__doc__)
    for how in HOW:
        parser.add_argument(f"--{how}", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--dry", action="store_true", help="don't keep the numbers")
    parser.add_argument("--commands", nargs="+", default=list(COMMANDS), choices=list(COMMANDS))
    given = parser.parse_args()

    def keep(done: Done) -> None:
        if not given.dry:
            counts = {**read_counts(INTERRUPTS), **done}
            replace_text(INTERRUPTS, json.dumps(counts, indent=1, sort_keys=True) + "\n")

    wanted = {how: getattr(given, how) for how in HOW if getattr(given, how)}
    done = attempt(wanted, given.commands, given.seed, {} if given.dry else read_counts(INTERRUPTS), keep)
    if not given.dry:
        replace_text(PAGE, page(PAGE.read_text(), read_counts(TALLY), read_counts(INTERRUPTS)))
    sys.stdout.write(f"{json.dumps(done)}\n")
    return int(any(counts["wrong"] for counts in done.values()))


if __name__ == "__main__":
    sys.exit(main())
