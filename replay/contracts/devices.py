"""The device on which the networks of a replay run: an execution choice, as the number of threads is, no parameter.

Pipelines load networks in many places, some of them late. So the choice holds for all that is loaded in a `with` block,
and is read where a network is loaded.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Literal, TypeAlias, get_args

from fbench.replay.contracts.errors import ConfigError

Device: TypeAlias = Literal["cpu", "cuda"]


@dataclass(frozen=True, eq=False)
class Execution:
    """Where networks are to run, and what runs them."""

    device: Device = "cpu"
    providers: list[str] = field(default_factory=list)
    """Of onnxruntime, each once, in the order in which networks were loaded."""


_CHOSEN: ContextVar[Execution] = ContextVar("fbench_execution")


def check_device(name: str) -> None:
    """Raise ConfigError for a device that there isn't."""
    if name not in get_args(Device):
        raise ConfigError(f"--device {name}: expected {' or '.join(get_args(Device))}")


@contextmanager
def use_device(device: Device) -> Iterator[Execution]:
    """Run the networks on a device that are loaded by this thread in a `with` block."""
    token = _CHOSEN.set(Execution(device))
    try:
        yield _CHOSEN.get()
    finally:
        _CHOSEN.reset(token)


def current_execution() -> Execution:
    """Return the choice that holds, and what was loaded under it; outside of any, networks run on the CPU."""
    return _CHOSEN.get(Execution())


def note_provider(name: str) -> None:
    """Note by which provider a network that was loaded runs."""
    providers = current_execution().providers
    if name not in providers:
        providers.append(name)
