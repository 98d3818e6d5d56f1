"""Detectors that fbench knows by name, the folder with fetched ones, and how they are fetched and checked.

Nothing is listed whose address and sha256 aren't public. What was looked up, and where:

- YOLOX: addresses, input sizes and AP from the authors' page. Their release comes without checksums; these are what
  projects that download the files pin, several for each file and all equal (among them the Julia package YOLOWeights,
  which holds all six; the sizes in bytes are from such lists too).
- DEIMv2: AP from the authors' page. They publish PyTorch checkpoints and a script that exports them; the ONNX files are
  exports that the repository Kazuhito00/DEIMv2-ONNX-Sample keeps. The addresses name one commit of it; sizes and
  checksums were taken from that commit, and input sizes from the files.
"""

import hashlib
import http.client
import os
import urllib.error
import urllib.request
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from http.client import HTTPMessage
from pathlib import Path
from typing import IO, Any, Literal, TypeAlias
from urllib.parse import urljoin, urlsplit

from fbench.replay.contracts.errors import ConfigError, ModelError, did_you_mean
from fbench.replay.data.files import Draft, expand_user, fbench_cache, is_file, make_folder

_YOLOX_PAGE = "https://github.com/Megvii-BaseDetection/YOLOX/blob/main/demo/ONNXRuntime/README.md"
_YOLOX = "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0"
_DEIMV2_PAGE = "https://github.com/Intellindust-AI-Lab/DEIMv2"
_DEIMV2 = (
    "https://raw.githubusercontent.com/Kazuhito00/DEIMv2-ONNX-Sample/f88d4382abca74edb26ed4c7f46190ac40da0ea5/model"
)
# GitHub sends who asks for a file of a release to one of these.
_GITHUB = ("https://github.com", *(f"https://{kind}.githubusercontent.com" for kind in ("release-assets", "objects")))
_RAW = ("https://raw.githubusercontent.com",)


@dataclass(frozen=True)
class Entry:
    """One file that can be fetched."""

    name: str  # As given to `fbench weights get`, and in place of a path
    model: str
    by: str  # Who trained it, and who exported it where that is another
    licence: str  # SPDX identifier, of the repository that publishes the file
    ap: float  # COCO AP (IoU 0.5 to 0.95) in percent, as the authors state it on `page`
    input_wh: tuple[int, int]  # Width and height of the input [px]
    page: str  # Address of what the authors say about it
    url: str
    origins: tuple[str, ...]  # `SCHEME://HOST[:PORT]` of all addresses that it may be fetched from, by redirection too
    num_bytes: int
    sha256: str

    @property
    def file_name(self) -> str:
        """What the file is called, at its address and in the cache."""
        return self.url.rpartition("/")[2]


def _entry(name: str, ap: float, side_px: int, num_bytes: int, sha256: str) -> Entry:
    family, size = name.split("-")
    by, page, url, origins = {
        "YOLOX": ("Megvii", _YOLOX_PAGE, f"{_YOLOX}/yolox_{size.lower()}.onnx", _GITHUB),
        "DEIMv2": (
            "Intellindust AI Lab, exported by Kazuhito00",
            _DEIMV2_PAGE,
            f"{_DEIMV2}/deimv2_hgnetv2_{size.lower()}_coco.onnx",
            _RAW,
        ),
    }[family]
    sides = side_px, side_px
    return Entry(name.lower(), name, by, "Apache-2.0", ap, sides, page, url, origins, num_bytes, sha256)


CATALOGUE = (
    _entry("DEIMv2-Atto", 23.8, 320, 2_248_408, "b114aa6610ac7c2bd9b3186ffb001afa872430db957407ef2473f7148d00646e"),
    _entry("DEIMv2-Femto", 31.0, 416, 4_116_144, "c6ad358f750132b891165e034c2ba507abefc5ebe1c1d2732a0acbcacc47e52c"),
    _entry("YOLOX-Nano", 25.8, 416, 3_659_407, "c789161ed43c8269fcd4e67c67eeeb4e80c622da2eb296a20bc6007bd18a0b7d"),
    _entry("YOLOX-Tiny", 32.8, 416, 20_219_662, "427cc366d34e27ff7a03e2899b5e3671425c262ea2291f88bb942bc1cc70b0f7"),
    _entry("YOLOX-S", 40.5, 640, 35_858_002, "c5c2d13e59ae883e6af3b45daea64af4833a4951c92d116ec270d9ddbe998063"),
    _entry("YOLOX-M", 47.2, 640, 101_259_744, "21ff6cfdeb53b013bac2249599e55f00bff3cfdfdab37ed7a4620818c1d15b3f"),
    _entry("YOLOX-L", 50.1, 640, 216_746_733, "7860ae79de6c89a3c1eb72ae9a2756c0ccfbe04b7791bb5880afabd97855a411"),
    _entry("YOLOX-X", 51.5, 640, 396_142_663, "c892d7aaf1c4746d8a4d675bec669a4db4f434b4ee1efb654bc9b353379c7c55"),
)


def find_entry(name: str, catalogue: Sequence[Entry] = CATALOGUE) -> Entry:
    """Return the entry of a name. Raises ConfigError for an unknown name, with the nearest one."""
    for entry in catalogue:
        if entry.name == name:
            return entry
    raise ConfigError(f"unknown weights '{name}'{did_you_mean(name, [entry.name for entry in catalogue])}")


State = Literal["absent", "good", "damaged"]
BLOCK_BYTES = 1 << 20


def weights_folder() -> Path:
    """Folder `weights` in fbench's cache. Raises ConfigError without a home folder or another in `FBENCH_CACHE`."""
    try:
        return fbench_cache() / "weights"
    except RuntimeError as error:
        raise ConfigError(f"no folder for weights ({error}): name one in FBENCH_CACHE") from error


def state(entry: Entry, path: Path) -> State:
    """Tell whether a file is there, and whether it is the published one. Raises ModelError where it can't be read."""
    try:
        if not path.is_file():
            return "absent"
        if path.stat().st_size != entry.num_bytes:
            return "damaged"
        with path.open("rb") as file:
            return "good" if hashlib.file_digest(file, "sha256").hexdigest() == entry.sha256 else "damaged"
    except OSError as error:
        raise ModelError(f"{path}: can't be read ({error.strerror or error})") from error


def file_blocks(path: Path) -> Iterator[bytes]:
    """Yield the content of a file. Raises ConfigError where it can't be read."""
    try:
        with path.open("rb") as file:
            while block := file.read(BLOCK_BYTES):
                yield block
    except OSError as error:
        raise ConfigError(f"{path}: weights can't be read ({error.strerror or error})") from error


def store(entry: Entry, blocks: Iterable[bytes], source: str, target: Path) -> None:
    """Write what comes from `source` to `target`, if it is the published file; what was there before is replaced.
    Raises ModelError where it isn't, or can't be written; nothing is left behind.
    """
    try:
        make_folder(target.parent)
        digest, num_bytes = hashlib.sha256(), 0
        with Draft(target) as draft:
            with draft.path.open("wb") as out:
                for block in blocks:
                    num_bytes += len(block)
                    if num_bytes > entry.num_bytes:
                        why = f"{source}: longer than the {entry.num_bytes} bytes of {entry.name}, not taken"
                        raise ModelError(why)
                    digest.update(block)
                    out.write(block)
            if num_bytes < entry.num_bytes:
                raise ModelError(
                    f"{source}: ends after {num_bytes} of the {entry.num_bytes} bytes of {entry.name}, fetch it again"
                )
            if (found := digest.hexdigest()) != entry.sha256:
                raise ModelError(
                    f"{source}: isn't {entry.name} as published, not taken (sha256 {found}, expected {entry.sha256})"
                )
            draft.publish()
    except OSError as error:
        raise ModelError(
            f"{target.parent}: {entry.file_name} can't be written there ({error.strerror or error}); "
            "FBENCH_CACHE may name another folder"
        ) from error


Weights: TypeAlias = Literal["auto"] | Path | None
"""A file, or a name of the catalogue; `auto` are the built-in ones on simulated logs, and none on others."""
AUTO: Literal["auto"] = "auto"
_PARAMETER = ".weights"


def resolve(weights: Weights, catalogue: Sequence[Entry] = CATALOGUE) -> Weights:
    """Return the file of a name of the catalogue; paths, `auto` and `None` stay as they are.

    A name is what has neither folder nor suffix, unless a file is called so. Raises ConfigError for an unknown name,
    and where the file wasn't fetched. Raises ModelError where the file isn't the published one.
    """
    if not isinstance(weights, Path) or weights.suffix or weights.parent != Path() or is_file(weights):
        return weights
    if os.path.isdir(weights) and all(entry.name != weights.name for entry in catalogue):
        raise ConfigError(f"weights '{weights}': a folder; name an ONNX file")
    entry = find_entry(weights.name, catalogue)
    path = weights_folder() / entry.file_name
    found = state(entry, path)
    if found == "absent":
        raise ConfigError(f"weights '{entry.name}' aren't at {path}: fbench weights get {entry.name}")
    if found == "damaged":
        raise ModelError(f"{path}: isn't {entry.name} as published; to fetch it anew: fbench weights get {entry.name}")
    return path


def resolve_settings(settings: Sequence[str], catalogue: Sequence[Entry] = CATALOGUE) -> tuple[str, ...]:
    """Return settings `SENSOR.NAME=VALUE` with files in place of names, where they set weights; see `resolve`."""
    result = []
    for setting in settings:
        path, _, text = setting.partition("=")
        is_file_wanted = path.endswith(_PARAMETER) and text not in (AUTO, "none")
        result.append(f"{path}={resolve(expand_user(text), catalogue)}" if is_file_wanted else setting)
    return tuple(result)


TIMEOUT_S = 30.0


def download(entry: Entry, target: Path, timeout_s: float = TIMEOUT_S) -> Iterator[bytes]:
    """Yield the content of an entry's address as it comes in; proxies are taken from the environment. Raises ModelError
    where the address can't be reached, or leads where the entry doesn't allow; it says that the file belongs at
    `target`. `timeout_s` is the longest wait [s] for an answer, or for the next bytes.
    """
    opener = urllib.request.build_opener(_Redirects(entry))
    request = urllib.request.Request(entry.url, headers={"User-Agent": "fbench"})  # noqa: S310 from the catalogue
    try:
        with opener.open(request, timeout=timeout_s) as response:
            while block := response.read1(BLOCK_BYTES):
                yield block
    except urllib.error.HTTPError as error:
        error.close()
        raise _fetch_error(entry, target, f"the server says {error.code} {error.reason}") from error
    except (OSError, http.client.HTTPException) as error:
        raise _fetch_error(entry, target, _reason(error, timeout_s)) from error
    except ValueError as error:  # what urllib makes of `https_proxy=http:/host`
        raise _fetch_error(entry, target, "the environment names a proxy whose address is broken") from error


class _Redirects(urllib.request.HTTPRedirectHandler):
    def __init__(self, entry: Entry) -> None:
        self._entry = entry

    def http_error_302(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: HTTPMessage
    ) -> Any:
        where = origin(headers.get("location", headers.get("uri", "")), req.full_url)  # in urllib, either leads on
        if where not in self._entry.origins:
            fp.close()
            raise ModelError(f"{self._entry.url}: redirects to {where}, not followed")
        return super().http_error_302(req, fp, code, msg, headers)

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302


def origin(url: str, base: str = "") -> str:
    """`SCHEME://HOST[:PORT]` of an address, which may be relative to `base`; of a broken one what no entry has."""
    try:
        parts = urlsplit(urljoin(base, url))
    except ValueError:
        return "a broken address"
    return f"{parts.scheme}://{parts.netloc.lower()}"


def _fetch_error(entry: Entry, target: Path, reason: str) -> ModelError:
    return ModelError(
        f"{entry.url}: can't be fetched ({reason}); fetch it in another way and put it at {target}, "
        f"or give it to: fbench weights get {entry.name} --from FILE"
    )


def _reason(error: OSError | http.client.HTTPException, timeout_s: float) -> str:
    """Why there is no answer, without the classes that errors are wrapped in."""
    cause = error.reason if isinstance(error, urllib.error.URLError) else error
    if isinstance(cause, TimeoutError):
        return f"no answer within {timeout_s:g} s"
    if isinstance(cause, http.client.HTTPException):
        return "the transfer was cut" if isinstance(cause, http.client.IncompleteRead) else "no valid answer"
    return (cause.strerror or str(cause)) if isinstance(cause, OSError) else str(cause)
