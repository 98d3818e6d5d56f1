"""Makes a finding smaller while it stays the same finding, and adds it to the corpus.

`python -m tests.hostile.minimize KIND NUMBER` prints the file.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from hashlib import blake2b
from itertools import pairwise
from pathlib import Path

from tests.hostile.target import Case
from tests.hostile.targets import TARGETS
from tests.hostile.worker import Worker, worker

CORPUS = Path(__file__).parent / "corpus"
_NUM_TRIES = 400
_IN_PROCESS = ("silent", "error")  # Others end the process, or take long


def signature(outcome: str, detail: str) -> str:
    """What tells one finding from another: its outcome, and type and place of the error."""
    return f"{outcome} {detail.partition(':')[0]} {detail.partition(':')[2].partition(':')[0]}"


def reduce(case: Case, is_same: Callable[[Case], bool]) -> Case:
    """Undo damage, or leave out bytes, in ever smaller pieces, as long as the finding is the same."""
    tries = 0
    for name in sorted(case.files):
        size = len(case.files[name])
        piece = max(1, size // 2)
        while piece and tries < _NUM_TRIES:
            for smaller in _versions(case, name, piece):
                tries += 1
                if is_same(smaller):
                    case = smaller
                    break
                if tries == _NUM_TRIES:
                    return case
            else:
                piece //= 2
    return case


def _versions(case: Case, name: str, piece: int) -> Iterator[Case]:
    """The case with a piece of a file as it was before the damage, where its length is the same; else without it."""
    data = case.files[name]
    whole = None if case.whole is None else case.whole.get(name)
    if whole is None or len(whole) == len(data):
        for start, stop in pairwise([*range(0, len(data), piece), len(data)]):
            middle = b"" if whole is None else whole[start:stop]
            if middle != data[start:stop]:
                yield replace(case, files={**case.files, name: data[:start] + middle + data[stop:]})


def add(kind: str, case: Case) -> Path:
    """Write a case into the corpus, under a name that its content gives."""
    content = case.pack(kind)
    path = CORPUS / f"{kind}-{blake2b(content, digest_size=6).hexdigest()}"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    return path


def _is_same(one: Worker, wanted: str) -> Callable[[Case], bool]:
    return lambda case: signature(*one.judge(case)) == wanted


def main(kind: str, number: int, outcome: str) -> None:
    """Reduce a case, and add it."""
    with worker(kind, TARGETS[kind]) as one:
        case = one.case(number)
        if outcome in _IN_PROCESS:
            found = one.judge(case)
            case = reduce(case, _is_same(one, signature(*found)))
    sys.stdout.write(f"{add(kind, case)}\n")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
