"""Response time of `fbench --help`, against a bare typer application with as many commands."""

import subprocess
import sys
import time
from pathlib import Path
from statistics import median

NUM_COMMANDS = 8
COMMAND = "@app.command()\ndef command{i}(name: str, flag: bool = False) -> None:\n    'One line of help.'"
BARE = "\n".join([
    "import typer",
    "app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False, add_completion=False)",
    *(COMMAND.format(i=i) for i in range(NUM_COMMANDS)),
    "app()",
])  # fmt: skip


def seconds(command: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return time.perf_counter() - start


def main() -> None:
    ours = [str(Path(sys.executable).parent / "fbench"), "--help"]
    bare = [sys.executable, "-c", BARE, "--help"]
    for command in (ours, bare):
        seconds(command)
    # Taken in turns, so that a busy moment of the machine hits both.
    times = [(seconds(ours), seconds(bare)) for _ in range(15)]
    a, b = (median(column) for column in zip(*times, strict=True))
    print(f"fbench --help: {1e3 * a:.0f} ms, bare typer: {1e3 * b:.0f} ms, ratio {a / b:.2f} (at most 1.50 wanted)")


if __name__ == "__main__":
    main()
