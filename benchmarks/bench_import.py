"""Importing datasets against copying the bytes of the same files into an MCAP with zstd, in one process; and the peak
memory of importing a whole sequence against half of it, in fresh processes.

python benchmarks/bench_import.py [MB of each generated folder, default 200]

Real recordings are read from ../shared/data where they are; folders like those of KITTI's raw drives and of nuScenes
are generated.
"""

import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import best_s, peak_kib
from made_datasets import make_kitti, make_nuscenes

from fbench.datasets.importing.run import import_one
from fbench.replay.contracts.plugins import make_importer
from fbench.replay.logs.container import Channel, LogHeader
from fbench.replay.logs.containers.mcap.write import RawMcapWriter

SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
REPEATS = 3


@dataclass(frozen=True)
class Case:
    name: str
    dataset: str
    source: Path
    half: str = ""  # Frames of its first half


def list_opened_files(root: Path, work: Callable[[], object]) -> list[Path]:
    """Which files below a folder a piece of work reads."""
    paths: dict[Path, None] = {}
    is_over = False

    def see(event: str, args: tuple[Any, ...]) -> None:  # Stays for good
        if event == "open" and not is_over and isinstance(args[0], str | Path):
            path = Path(args[0])
            if path.is_relative_to(root) and path.is_file():
                paths[path] = None

    sys.addaudithook(see)
    work()
    is_over = True
    return list(paths)


def copy(paths: list[Path], out: Path) -> None:
    """Read each file, and write its bytes as a message."""
    writer = RawMcapWriter(out, LogHeader("copy"))
    channel = Channel("/file", "raw", None, {})
    for i, path in enumerate(paths):
        writer.add(channel, i, i, 0, path.read_bytes())
    writer.close()


def cases(folder: Path, num_bytes: float) -> Iterator[Case]:
    real = {"astyx": ("astyx", ":155"), "kitti_object": ("kitti", ""), "radiate_tiny_foggy": ("radiate", ":10")}
    for name, (dataset, half) in real.items():
        if (SHARED / name).is_dir():
            yield Case(name, dataset, SHARED / name, half)
    for name, dataset, make in (("kitti_raw", "kitti", make_kitti), ("nuscenes", "nuscenes", make_nuscenes)):
        (folder / name).mkdir()
        source = make(folder / name, num_bytes)
        num = len(list(source.glob("**/*.bin")))
        yield Case(f"{name} (generated)", dataset, source, f":{num // 2}")


def report(case: Case, out: Path) -> None:
    importer = make_importer(case.dataset, [])
    paths = list_opened_files(case.source, lambda: import_one(importer, case.source, out))
    megabytes = sum(path.stat().st_size for path in paths) / 1e6
    copied = best_s(lambda: copy(paths, out), REPEATS)
    imported = best_s(lambda: import_one(importer, case.source, out), REPEATS)
    what = f"importing {case.name} ({len(paths)} files, {megabytes:.0f} MB)"
    ratio = f"ratio {imported / copied:.2f} (at most 2 wanted)"
    print(f"{what}: {imported:.2f} s, copying {copied:.2f} s: {ratio}")
    if case.half:
        command = ["log", "import", case.dataset, str(case.source), "-o", str(out), "--overwrite"]
        part, whole = peak_kib(*command, "--frames", case.half), peak_kib(*command)
        print(f"  peak memory over twice the length: {whole / 1024:.0f} MiB, ratio {whole / part:.2f} (near 1 wanted)")


def main() -> None:
    megabytes = float(sys.argv[1]) if len(sys.argv) > 1 else 200.0
    with tempfile.TemporaryDirectory() as name:
        for case in cases(Path(name), 1e6 * megabytes):
            report(case, Path(name) / "out.mcap")


if __name__ == "__main__":
    main()
