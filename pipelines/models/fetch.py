"""Fetching of weights over the network: from the addresses of their entry, and from nowhere else."""

import http.client
import urllib.error
import urllib.request
from collections.abc import Iterator
from http.client import HTTPMessage
from pathlib import Path
from typing import IO, Any
from urllib.parse import urljoin, urlsplit

from fbench.pipelines.models.weights import BLOCK_BYTES, Entry
from fbench.replay.contracts.errors import ModelError

TIMEOUT_S = 30.0


def downloaded(entry: Entry, target: Path, timeout_s: float = TIMEOUT_S) -> Iterator[bytes]:
    """Yield the content of an entry's address as it comes in; proxies are taken from the environment.

    Args:
        entry: What to fetch.
        target: Where the file belongs; errors say so to who must fetch it by hand.
        timeout_s: Longest wait for an answer, or for the next bytes.

    Raises:
        ModelError: where the address can't be reached, or leads where the entry doesn't allow.
    """
    opener = urllib.request.build_opener(_Redirects(entry))
    request = urllib.request.Request(entry.url, headers={"User-Agent": "fbench"})  # noqa: S310 from the catalogue
    try:
        with opener.open(request, timeout=timeout_s) as response:
            while block := response.read1(BLOCK_BYTES):
                yield block
    except urllib.error.HTTPError as error:
        error.close()
        raise _failed(entry, target, f"the server says {error.code} {error.reason}") from error
    except (OSError, http.client.HTTPException) as error:
        raise _failed(entry, target, _reason(error, timeout_s)) from error
    except ValueError as error:  # what urllib makes of `https_proxy=http:/host`
        raise _failed(entry, target, "the environment names a proxy whose address is broken") from error


class _Redirects(urllib.request.HTTPRedirectHandler):
    """Follows only to the origins of an entry."""

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


def _failed(entry: Entry, target: Path, reason: str) -> ModelError:
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
