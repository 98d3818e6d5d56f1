"""Fuzz all kinds of input for some minutes, keep what was tried in `tally.json`, and make the table of docs/faults.md.

`make fuzz MINUTES=60` goes on where the last run ended. Each new finding is reduced and added to `corpus/`, where the
fast tests try it again; exit code 1 says that there is one.
"""

import argparse
import json
import os
import selectors
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.hostile.minimize import CORPUS, signature
from tests.hostile.target import FINDINGS, OUTCOMES
from tests.hostile.targets import TARGETS

from fbench.replay.data.files import replace_text

ROOT = Path(__file__).resolve().parents[2]
TALLY, PAGE = Path(__file__).parent / "tally.json", ROOT / "docs" / "faults.md"
INTERRUPTS = TALLY.with_name("interrupts.json")  # What `tests.hostile.interrupt` keeps
_COMMANDS = ("replay", "convert", "import", "report", "demo", "bench")
BEGIN, END = "<!-- begin: what was tried -->\n", "<!-- end: what was tried -->\n"
_BATCH = 5000  # Of which each begins with seconds of imports
_MAX_CPU_S, _MAX_ASLEEP = 60, 30  # Without a word from a worker: in code that no signal interrupts, or that hangs
_LOOK_S = 10
Tally = dict[str, dict[str, int]]


def judge(arguments: Sequence[object], total: int) -> Iterator[tuple[str, int, str, str]]:
    """Yield what a worker says of `total` cases; one that ends it is a finding, after which nothing comes."""
    command = [sys.executable, "-m", "tests.hostile.worker", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            num = num_asleep = 0
            since_s = _cpu_s(process.pid)[0]
            while num < total:
                if not selector.select(_LOOK_S):
                    taken_s, is_asleep = _cpu_s(process.pid)
                    num_asleep = num_asleep + 1 if is_asleep else 0
                    if taken_s - since_s > _MAX_CPU_S or num_asleep > _MAX_ASLEEP:
                        process.kill()
                        yield "", -1, "time", f"over {_MAX_CPU_S} s in code that can't be interrupted, or it hangs"
                        return
                    continue
                if not (line := process.stdout.readline()):
                    break
                kind, number, outcome, detail = json.loads(line)
                yield kind, number, outcome, detail
                num, num_asleep, since_s = num + 1, 0, _cpu_s(process.pid)[0]
        rest = process.stderr.read()
        if process.wait():
            yield "", -1, "crash", f"exit code {process.returncode}: {(rest.splitlines() or [''])[-1][:200]}"


def _cpu_s(pid: int) -> tuple[float, bool]:
    """CPU time of a process [s], and whether it sleeps: the clock on the wall would blame a busy machine's cases."""
    state, *values = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(values[10]) + int(values[11])) / os.sysconf("SC_CLK_TCK"), state == "S"


def fuzz(kind: str, first: int, stop: int, found: Counter[str], known: set[str]) -> None:
    """Try the cases of a kind from `first` up to `stop`; counts outcomes, and adds new findings to the corpus."""
    at = first
    while at < stop:
        for _, number, outcome, detail in judge([at, stop, kind], stop - at):
            last = at if number < 0 else number
            found[outcome] += 1
            if outcome in FINDINGS and (key := f"{kind} {signature(outcome, detail)}") not in known:
                known.add(key)
                added = subprocess.run(
                    [sys.executable, "-m", "tests.hostile.minimize", kind, str(last), outcome],
                    capture_output=True, text=True, cwd=ROOT, timeout=600,
                )  # fmt: skip
                sys.stdout.write(
                    f"{kind} {last}: {outcome}: {detail}\n  {added.stdout.strip() or added.stderr[-300:]}\n"
                )
                sys.stdout.flush()
            at = last + 1


def count_mended() -> Mapping[str, int]:
    """Findings of each kind that are in the corpus."""
    return Counter(path.name.rpartition("-")[0] for path in sorted(CORPUS.iterdir()))


def table(tally: Mapping[str, Mapping[str, int]]) -> str:
    """The rows of docs/faults.md."""
    mended = count_mended()
    lines = [
        f"| input | cases | {' | '.join(OUTCOMES.values())} | open findings | found and mended |",
        f"|---|{'---:|' * (len(OUTCOMES) + 3)}",
    ]
    for kind, target in TARGETS.items():
        counts = tally.get(kind, {})
        open_ones = sum(counts.get(name, 0) for name in FINDINGS)
        numbers = [sum(counts.values()), *(counts.get(name, 0) for name in OUTCOMES), open_ones, mended.get(kind, 0)]
        lines.append(f"| {target.what} | {' | '.join(f'{number:,}' for number in numbers)} |")
    return "".join(f"{line}\n" for line in lines)


INTERRUPTIONS = {
    "kills": "killed at a random instant",
    "full": "disk full, from the start or from a random instant on",
    "locked": "no right to write in its folders, from the start or from a random instant on",
}


FINISHED = "finished before"  # Of those that are counted by the command's name


def num_running(counts: Mapping[str, int]) -> int:
    """How many commands were interrupted while they ran."""
    return sum(num for name, num in counts.items() if name in _COMMANDS) - counts.get(FINISHED, 0)


def interruption_table(counts: Mapping[str, Mapping[str, int]]) -> str:
    """The rows of docs/faults.md on commands that were interrupted."""
    lines = [
        "| interruption | while it ran | the command had finished before | something lost, half or unclear |",
        "|---|---:|---:|---:|",
    ]
    for how, what in INTERRUPTIONS.items():
        of = counts.get(how, {})
        lines.append(f"| {what} | {num_running(of)} | {of.get(FINISHED, 0)} | {of.get('wrong', 0)} |")
    return "".join(f"{line}\n" for line in lines)


def page(text: str, tally: Mapping[str, Mapping[str, int]], interruptions: Mapping[str, Mapping[str, int]]) -> str:
    """The page with the tables of these counts."""
    before, _, rest = text.partition(BEGIN)
    return f"{before}{BEGIN}\n{table(tally)}\n{interruption_table(interruptions)}\n{END}{rest.partition(END)[2]}"


def read_counts(path: Path) -> dict[str, dict[str, int]]:
    """What was kept; nothing where nothing was."""
    return json.loads(path.read_text()) if path.exists() else {}


def main() -> int:
    """Fuzz; returns 1 where there is a finding."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10)
    parser.add_argument("--cases", type=int, default=10**9, help="stop where each kind had so many")
    parser.add_argument("--kinds", nargs="+", default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument("--again", action="store_true", help="forget what was tried, after a mend")
    given = parser.parse_args()
    tally: Tally = read_counts(TALLY)
    if given.again:
        tally = {kind: counts for kind, counts in tally.items() if kind not in given.kinds}
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    end, known = time.monotonic() + 60 * given.minutes, set[str]()
    while time.monotonic() < end and (kind := _next(tally, given.kinds, given.cases)):
        counts: Counter[str] = Counter(tally.get(kind, {}))
        first = counts.total()
        try:
            fuzz(kind, first, min(first + _BATCH, given.cases), counts, known)
        finally:  # what was tried before an end from outside counts, too
            tally[kind] = dict(sorted(counts.items()))
            write(tally)
    return int(bool(known))


def _next(tally: Tally, kinds: Sequence[str], most: int) -> str | None:
    """The kind of which the fewest cases were tried."""
    num, kind = min((sum(tally.get(kind, {}).values()), kind) for kind in kinds)
    return kind if num < most else None


def write(tally: Mapping[str, Any]) -> None:
    """Keep the tally, and bring the page up to date."""
    replace_text(TALLY, json.dumps(tally, indent=1, sort_keys=True) + "\n")
    replace_text(PAGE, page(PAGE.read_text(), tally, read_counts(INTERRUPTS)))


if __name__ == "__main__":
    sys.exit(main())
