"""Replays cells in a process of its own: `python -m fbench.api.suites.worker [BYTES]`.

Each line of stdin is a cell, each line of stdout the answer to it. It ends with stdin, even amid a cell: then who asked
is gone, and whoever asks next must not meet what it would still write. Of the messages that cells share it keeps BYTES.
"""

import os
import signal
import sys
import threading
import time
from queue import SimpleQueue
from types import FrameType

from fbench.api.replays import replay
from fbench.api.suites.cells import RESPONSE, Response, own_stdout
from fbench.replay.contracts.errors import BusyError, FbenchError, TerminatedError, one_line
from fbench.replay.engine.shared import SharedLogs
from fbench.replay.setup.request import ReplayRequest

_LACKS_SENSOR = "CFG001"
_BUSY_S, _PAUSE_S = 60.0, 0.5  # How long a run folder may be in the hands of a process that is about to end


def main() -> int:
    """Respond to every line."""
    import cv2

    cv2.setNumThreads(1)
    signal.signal(signal.SIGTERM, _end)
    lines = SimpleQueue[bytes]()
    threading.Thread(target=_read, args=(lines,), daemon=True).start()
    try:
        with own_stdout() as out, SharedLogs(int(sys.argv[1]) if len(sys.argv) > 1 else 0) as shared:
            while line := lines.get():
                response = _respond(ReplayRequest.from_json(line.decode()), shared)
                print(RESPONSE.dump_json(response).decode(), file=out, flush=True)
    except (TerminatedError, KeyboardInterrupt):
        return 128 + signal.SIGTERM
    return 0


def _read(lines: "SimpleQueue[bytes]") -> None:
    for line in sys.stdin.buffer:
        lines.put(line)
    lines.put(b"")
    os.kill(os.getpid(), signal.SIGTERM)


def _respond(request: ReplayRequest, shared: SharedLogs) -> Response:
    end = time.monotonic() + _BUSY_S
    try:
        while True:
            try:
                replay(request, shared=shared)
                return Response()
            except BusyError:
                if time.monotonic() > end:
                    raise
                time.sleep(_PAUSE_S)
    except FbenchError as error:
        return Response(str(error), error.code == _LACKS_SENSOR)
    except Exception as error:  # noqa: BLE001  # one cell mustn't stop the rest
        return Response(one_line(error))


def _end(number: int, frame: FrameType | None) -> None:
    raise TerminatedError


if __name__ == "__main__":
    sys.exit(main())
