"""What `fbench weights` does and prints."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from fbench.replay.cli.progress import byte_progress
from fbench.replay.cli.show import console, print_json

if TYPE_CHECKING:
    from fbench.pipelines.weights.catalogue import Entry

_SHOWN = {"absent": "–", "good": "yes", "damaged": "damaged"}


def show_weights(catalogue: "Sequence[Entry]", as_json: bool) -> None:
    """Print the entries of a catalogue, and what of them is in the cache."""
    from fbench.pipelines.weights.cache import state, weights_folder

    folder = weights_folder()
    rows = [(entry, state(entry, folder / entry.file_name)) for entry in catalogue]
    if as_json:
        print_json([_described(entry, folder / entry.file_name, found) for entry, found in rows])
        return
    table = Table(box=None, pad_edge=False)
    for column in ("name", "licence", "COCO AP", "MB", "input", "here", "model"):
        table.add_column(column, justify="right" if column in ("COCO AP", "MB") else "left")
    for entry, found in rows:
        cells = (f"{entry.ap:.1f}", f"{entry.num_bytes / 1e6:.1f}", "x".join(map(str, entry.input_wh)), _SHOWN[found])
        table.add_row(entry.name, entry.licence, *cells, f"{entry.model}, {entry.by}")
    console().print(table)
    _tell(f"kept in {folder}")


def get_weights(entry: "Entry", file: Path | None) -> None:
    """Fetch weights, or take them from a file, unless they are in the cache; say where they are."""
    from fbench.pipelines.weights.cache import file_blocks, state, store, weights_folder
    from fbench.pipelines.weights.fetch import downloaded

    target = weights_folder() / entry.file_name
    if state(entry, target) == "good":
        _tell(f"{target}: there already, sha256 checked")
    else:
        blocks = file_blocks(file) if file is not None else downloaded(entry, target)
        with byte_progress(entry.file_name, entry.num_bytes) as progress:
            store(entry, _counted(blocks, progress), str(file or entry.url), target)
        _tell(f"{target}: {entry.model} by {entry.by}, {entry.licence}, sha256 checked")
    _tell(f"use it with --set camera.weights={entry.name}")


def _tell(line: str) -> None:
    console().print(line, soft_wrap=True)


def _counted(blocks: Iterable[bytes], progress: Callable[[int], None]) -> Iterator[bytes]:
    num_bytes = 0
    for block in blocks:
        num_bytes += len(block)
        progress(num_bytes)
        yield block


def _described(entry: "Entry", path: Path, found: str) -> dict[str, object]:
    return {
        "name": entry.name,
        "model": entry.model,
        "by": entry.by,
        "licence": entry.licence,
        "coco_ap": entry.ap,
        "input_wh": list(entry.input_wh),
        "page": entry.page,
        "url": entry.url,
        "sha256": entry.sha256,
        "bytes": entry.num_bytes,
        "path": str(path),
        "state": found,
    }
