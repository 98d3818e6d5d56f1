"""Opening a log, whatever container it is in."""

from pathlib import Path

from fbench.replay.faults import FaultLog
from fbench.replay.protocols import Reader


def open_log(path: Path, faults: FaultLog) -> Reader:
    """Open a log; what is wrong with its data is counted in `faults`.

    Raises:
        LogError: where the file can't be read or isn't an MCAP file.
    """
    from fbench.replay.logs.mcap_read import McapReader

    return McapReader(path, faults)
