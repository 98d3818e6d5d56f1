"""One import from the command line: into MCAP, and from there into Parquet where that is asked for."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.faults import FaultLog
from fbench.replay.logs.convert.run import Wish, convert
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.open import open_container
from fbench.replay.protocols import Importer


def import_log(importer: Importer, source: Path, out: Path, overwrite: bool) -> Sequence[str]:
    """Write the log `out`; returns lines that say what was found.

    Raises:
        ConfigError: where `out` exists, or is called like no log that fbench writes.
        LogError: naming what is wrong with the dataset.
    """
    if out.suffix not in (".mcap", ".parquet"):
        raise ConfigError(f"{out}: expected a name that ends in .mcap or .parquet")
    if out.exists() and not overwrite:
        raise ConfigError(f"{out}: exists already; choose another with --out, or --overwrite it")
    if out.suffix == ".mcap":
        return importer.convert(source, out)
    if not out.absolute().parent.is_dir():
        raise ConfigError(f"{out}: can't be written (no folder {out.absolute().parent})")
    with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.absolute().parent) as folder:
        log = Path(folder) / "log.mcap"
        lines = importer.convert(source, log)
        convert(open_container(log, FaultLog()), Target(out, overwrite), Wish())
        return lines
