"""Replays cells in a process of its own: `python -m fbench.api.suite_worker`.

Each line of stdin is a cell, each line of stdout the answer to it; it ends with stdin.
"""

import signal
import sys
from types import FrameType

from fbench.api.cells import RESPONSE, Response, own_stdout
from fbench.api.runs import replay
from fbench.replay.contracts.errors import FbenchError, TerminatedError, one_line
from fbench.replay.setup.request import ReplayRequest

_LACKS_SENSOR = "CFG001"


def main() -> int:
    """Respond to every line."""
    import cv2

    cv2.setNumThreads(1)
    signal.signal(signal.SIGTERM, _end)
    try:
        with own_stdout() as out:
            for line in sys.stdin.buffer:
                response = _respond(ReplayRequest.from_json(line.decode()))
                print(RESPONSE.dump_json(response).decode(), file=out, flush=True)
    except (TerminatedError, KeyboardInterrupt):
        return 128 + signal.SIGTERM
    return 0


def _respond(request: ReplayRequest) -> Response:
    try:
        replay(request)
    except FbenchError as error:
        return Response(str(error), error.code == _LACKS_SENSOR)
    except Exception as error:  # noqa: BLE001  # one cell mustn't stop the rest
        return Response(one_line(error))
    return Response()


def _end(number: int, frame: FrameType | None) -> None:
    raise TerminatedError


if __name__ == "__main__":
    sys.exit(main())
