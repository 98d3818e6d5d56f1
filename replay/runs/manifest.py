"""The manifest of a run. Equal inputs give equal bytes; data of the host live apart."""

import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from fbench.replay.contracts.conditions import Part
from fbench.replay.contracts.devices import current_execution
from fbench.replay.contracts.errors import RunError
from fbench.replay.data.rig import CameraModel, Kind, LogInfo, Mount, Rig
from fbench.replay.runs.host import describe_cuda
from fbench.replay.runs.secrets import clean_mapping

FORMAT = 1
_Three = Annotated[list[float], Field(min_length=3, max_length=3)]
_Four = Annotated[list[float], Field(min_length=4, max_length=4)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LogEntry(_Strict):
    """Which log was replayed."""

    name: str
    log_id: str
    digest: str  # blake2b over all messages that were read, in canonical order
    metadata: dict[str, str]


class MountEntry(_Strict):
    """A sensor's pose on the body."""

    kind: Kind
    translation_m: _Three
    rotation_xyzw: _Four


class CameraEntry(_Strict):
    """Intrinsics of a camera."""

    K: Annotated[list[_Three], Field(min_length=3, max_length=3)]
    size_wh: tuple[int, int]
    distortion_model: str
    distortion: list[float]


class RigEntry(_Strict):
    """The rig from a segment on."""

    segment: int
    mounts: dict[str, MountEntry]
    cameras: dict[str, CameraEntry]

    @property
    def rig(self) -> Rig:
        """The rig as data."""
        mounts = {
            n: Mount(m.kind, np.array(m.translation_m), np.array(m.rotation_xyzw)) for n, m in self.mounts.items()
        }
        cameras = {
            n: CameraModel(np.array(c.K), c.size_wh, c.distortion_model, np.array(c.distortion, np.float64))
            for n, c in self.cameras.items()
        }
        return Rig(mounts, cameras)


class FrameEntry(_Strict):
    """How messages were put into frames."""

    reference: str
    timeout_ns: int
    tolerance_ns: int
    max_gap_ns: int
    max_jump_ns: int = 1_000_000_000
    stamps: str = "header"  # Which time counts as the instant of measurement: `header` or `log`
    offsets_ns: dict[str, int] = {}  # Added to the stamps of a sensor
    topics: list[str] = []  # Patterns of those that were read; empty: all
    sensors: list[str] = []  # Patterns of the sensors that the pipeline got; empty: all
    excerpt: str = "all"
    """Which frames were replayed: `all`, or half-open ranges such as `from +5ns to 90ns frames 30:40`."""


class ConditionEntry(_Strict):
    """A condition that disturbed the messages."""

    name: str
    version: int
    strength: str  # Severity 1 to 5, or a value such as `150m`
    level: dict[str, float]
    sensors: str = ""  # Kind, name or pattern; empty: all of the condition's kinds
    from_s: float | None = None  # After the log's first message, in log time
    to_s: float | None = None

    def __str__(self) -> str:
        scope = f".{self.sensors}" if self.sensors else ""
        begin, end = ("" if seconds is None else f"{seconds:g}s" for seconds in (self.from_s, self.to_s))
        window = f" ({begin}-{end})" if begin or end else ""
        return f"{self.name}{scope}:{self.strength}{window}"


class InputEntry(_Strict):
    """A file beside the log that decided how it was read."""

    role: str  # `config`, `rig` or `results`
    name: str  # Without the folder
    digest: str  # blake2b over the file, or over names and content of the folder's files
    frame: str = ""  # Coordinate frame of 3D boxes where the user named it
    camera: str = ""  # Camera of 2D boxes where the user named it


class TruthEntry(_Strict):
    """A file that ground truth came from, instead of the log."""

    name: str  # Without the folder
    format: str  # One of `formats.open.FORMATS`
    digest: str
    """blake2b over the file, with that of `seqinfo.ini` or the table of samples beside it; or over names and content of
    the folder's files"""
    frame: str = ""  # Coordinate frame of 3D boxes where the user named it
    camera: str = ""  # Camera of 2D boxes where the user named it
    classes: str = ""
    """Digest of the labels that a configuration gave to names of classes when a finished run got this truth; that of a
    replay is among the inputs"""


class InterpolationEntry(_Strict):
    """Frames that have no truth of their own, but got some from the truths around them."""

    max_gap_ns: int = 0  # Those truths are at most this far apart; 0: no frame did
    num_frames: int = 0


class ProfileEntry(_Strict):
    """The file that times were drawn from."""

    name: str  # Without the folder
    digest: str  # blake2b over the file
    seed: int  # Of the random numbers


class LatencyEntry(_Strict):
    """How long the pipeline was taken to need for frames, and what became of those that came meanwhile."""

    service_ns: int | None  # The same for each frame, in time of the wall clock; `None`: measured in this run, or drawn
    overload: str  # `newest`, `skip` or `fifo:N`
    rate: float = 1.0  # Log time passed so many times as fast as the wall clock
    num_dropped: int  # Frames that the pipeline didn't get
    profile: Annotated[ProfileEntry | None, Field(exclude_if=lambda entry: entry is None)] = None
    """`None`: nothing was drawn."""

    def __str__(self) -> str:
        how = "measured" if self.service_ns is None else f"fixed:{self.service_ns / 1e6:.12g}ms"
        how = how if self.profile is None else f"profile:{self.profile.name} with seed {self.profile.seed}"
        return f"{how}, overload {self.overload}, at {self.rate:g}x"


class VariantEntry(_Strict):
    """The variant of a pipeline that ran."""

    name: str
    title: str
    base: str  # The pipeline
    sets: list[str]
    """Names of the parameters that it sets; their values are among `parameters`, where the command line's come last."""


_ON_CPU = "equal bytes on one type of machine, with equal versions"
_ON_CUDA = "equal bytes on one type of card, with equal versions; elsewhere within tolerances"


class ExecutionEntry(_Strict):
    """Where the pipeline's networks ran, and where they would give the same; how often is in `docs/determinism.md`."""

    device: str = "cpu"  # `cpu`, also where there is no network; or `cuda`
    provider: str | None = None  # Of onnxruntime; `None`: no network of fbench's ran
    determinism: str = _ON_CPU
    cuda: Annotated[dict[str, str], Field(exclude_if=lambda entry: not entry)] = {}
    """The `card`, its `driver`, and versions of packages; empty: networks ran on the CPU."""

    def __str__(self) -> str:
        return f"{self.device} ({self.cuda.get('card', 'an unknown card')})" if self.cuda else self.device


class Manifest(_Strict):
    """What ran, and whether all of it did."""

    format: int = FORMAT
    complete: bool  # False where data was lost beyond the fault budget
    has_tracks: bool = True  # False where the pipeline only detects, so that there is nothing to say of its tracks
    log: LogEntry
    pipeline: str
    parameters: dict[str, Any]
    variant: VariantEntry | None = None  # `None`: the pipeline is none
    frames: FrameEntry
    conditions: list[ConditionEntry] = []
    seed: int | None = None  # Of the conditions' random numbers; `None`: there were none
    effects: dict[
        str, dict[str, int | float]
    ] = {}  # What conditions changed, by sensor: counts, and sums of differences
    inputs: list[InputEntry] = []  # Files beside the log that decided how it was read
    truth: TruthEntry | None = None  # `None`: ground truth is the log's own
    interpolation: InterpolationEntry = InterpolationEntry()
    latency: Annotated[LatencyEntry | None, Field(exclude_if=lambda entry: entry is None)] = None  # `None`: lockstep
    execution: ExecutionEntry = ExecutionEntry()
    mounts: dict[str, MountEntry]
    cameras: dict[str, CameraEntry]
    images: dict[str, tuple[int, int]] = {}  # Size [px] of the images of cameras that aren't calibrated
    rig_changes: list[RigEntry] = []  # Where mounts or cameras changed within the log
    num_frames: int
    num_segments: int
    digest: str  # The last link of the chain of frame digests
    versions: dict[str, str]
    redacted: bool = False  # Whether names, paths, places and poses were left out

    @property
    def data_key(self) -> str:
        """What was replayed, equal for all pipelines: under conditions the log's digest differs with the sensors that a
        pipeline uses, since the others stay as recorded.
        """
        if not (self.conditions and self.log.log_id):
            return self.log.digest
        return f"{self.log.log_id} {'+'.join(map(str, self.conditions))} {self.seed}"

    @property
    def rig(self) -> Rig:
        """The rig of the first segment."""
        rig = RigEntry(segment=0, mounts=self.mounts, cameras=self.cameras).rig
        return replace(rig, bare=frozenset(self.images) - frozenset(rig.mounts))

    def rig_of(self, segment: int) -> Rig:
        """The rig of a segment."""
        held = [entry for entry in self.rig_changes if entry.segment <= segment]
        return held[-1].rig if held else self.rig

    @property
    def log_info(self) -> LogInfo:
        """The log as pipelines see it."""
        return LogInfo(self.log.name, self.log.log_id, self.log.metadata)


def rig_entry(segment: int, rig: Rig) -> RigEntry:
    """Return a rig in the manifest's form."""
    mounts = {
        n: MountEntry(kind=m.kind, translation_m=m.translation_m.tolist(), rotation_xyzw=m.rotation_xyzw.tolist())
        for n, m in sorted(rig.mounts.items())
    }
    cameras = {
        n: CameraEntry(
            K=c.K.tolist(), size_wh=c.size_wh, distortion_model=c.distortion_model, distortion=c.distortion.tolist()
        )
        for n, c in sorted(rig.cameras.items())
    }
    return RigEntry(segment=segment, mounts=mounts, cameras=cameras)


def condition_entry(part: Part) -> ConditionEntry:
    """Return a condition in the manifest's form."""
    begin, end = (None if ns is None else ns / 1e9 for ns in (part.from_ns, part.to_ns))
    return ConditionEntry(
        name=part.name, version=part.condition.version, strength=part.strength, level=dict(part.level),
        sensors=part.sensors, from_s=begin, to_s=end,
    )  # fmt: skip


def execution_entry() -> ExecutionEntry:
    """Return in the manifest's form what runs the networks of the replay around."""
    found = current_execution()
    provider = found.providers[0] if found.providers else None
    if provider is None or found.device == "cpu":
        return ExecutionEntry(provider=provider)
    return ExecutionEntry(device=found.device, provider=provider, determinism=_ON_CUDA, cuda=dict(describe_cuda()))


def save_manifest(path: Path, manifest: Manifest) -> None:
    """Write the manifest as JSON, without credentials; one that is redacted without names of files."""
    if manifest.redacted:
        inputs = [entry.model_copy(update={"name": ""}) for entry in manifest.inputs]
        truth = None if manifest.truth is None else manifest.truth.model_copy(update={"name": ""})
        manifest = manifest.model_copy(update={"inputs": inputs, "truth": truth})
        if manifest.latency is not None and (profile := manifest.latency.profile) is not None:
            profile = profile.model_copy(update={"name": ""})
            manifest = manifest.model_copy(update={"latency": manifest.latency.model_copy(update={"profile": profile})})
    kept = Manifest.model_validate(clean_mapping(manifest.model_dump()))
    path.write_text(kept.model_dump_json(indent=1) + "\n", encoding="utf-8")


def load_manifest(path: Path) -> Manifest:
    """Read a manifest. Raises RunError where there is none, or it is of another version."""
    try:
        return Manifest.model_validate_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise RunError(f"{path.parent}: not a run folder (no {path.name})") from None
    except (ValidationError, UnicodeDecodeError, OSError) as error:
        raise RunError(f"{path}: not a manifest of this version of fbench ({str(error).splitlines()[0]})") from error


_PACKAGES = (
    "fbench", "numpy", "scipy", "scikit-learn", "numba", "llvmlite", "opencv-python-headless", "onnxruntime", "embreex",
    "pyarrow", "mcap", "protobuf", "rosbags",
)  # fmt: skip
"""Those that compute, compile what computes, cast the rays of simulated logs, or read values out of logs."""
_EXTRAS = ("av",)
"""Listed where they are installed: it decodes video."""


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide results."""
    return dict(_versions())


@cache
def _versions() -> Mapping[str, str]:
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "absent"
    for name in _EXTRAS:
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    if versions["onnxruntime"] == "absent":
        with suppress(PackageNotFoundError):
            versions["onnxruntime"] = version("onnxruntime-gpu")  # the same module, and the same on the CPU
    return versions
