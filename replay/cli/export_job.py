"""What `fbench log export` does and prints."""

from collections.abc import Sequence

from fbench.replay.cli.fault_text import explained, fault_lines
from fbench.replay.cli.progress import import_progress
from fbench.replay.cli.show import console, print_json
from fbench.replay.errors import EXIT_LOSSY, EXIT_OK
from fbench.replay.export.run import Export, Exported, export
from fbench.replay.faults import FaultLog


def run_export(job: Export, as_json: bool) -> int:
    """Export, and print what was written and what was left out; returns the exit code.

    Raises:
        ConfigError: where files can't or mustn't be written.
        FbenchError: where a source can't be read, or the format can't hold what it has.
    """
    faults = FaultLog()
    printer = console()
    done: list[Exported] = []
    with explained(faults), import_progress(len(job.sources)) as progress:
        for exported in export(job, faults, progress):
            done.append(exported)
            with progress.finished(exported.num_frames):
                if not as_json:
                    printer.print(_line(exported).replace("\n", " "), markup=False, soft_wrap=True)
    rows = faults.rows()
    if as_json:
        path = str(job.place.path)
        print_json({"format": job.wish.format, "path": path, "sequences": _content(done), "faults": rows})
    else:
        for line in [*fault_lines(rows), f"{job.wish.format}: {job.place.path}"]:
            printer.print(line, markup=False, soft_wrap=True)
    return EXIT_LOSSY if faults.lost else EXIT_OK


def _content(done: Sequence[Exported]) -> list[dict[str, object]]:
    return [
        {
            "name": one.name, "frames": one.num_frames, "rows": one.num_rows, "left_out": dict(one.left_out),
            "view": one.view,
        }
        for one in done
    ]  # fmt: skip


def _line(one: Exported) -> str:
    left = ", ".join(f"{num} {reason}" for reason, num in one.left_out.items())
    found = f"{one.name}: {one.num_rows} rows in {one.num_frames} frames, {one.view}"
    return f"{found}; left out: {left}" if left else found
