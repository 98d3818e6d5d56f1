"""Reading stamps, ids and numbers that a file holds as text."""

import re
from decimal import Decimal, InvalidOperation
from hashlib import blake2b

import numpy as np

from fbench.replay.errors import LogError

_MAX_NS = 2**63 - 1
_MAX_S = Decimal(_MAX_NS // 10**9 + 1)
_ZONE = re.compile(r"([+-])(\d\d):?(\d\d)$", re.ASCII)
_HASHED = 1 << 62
"""From here on ids stand for texts."""


def stamp_of_seconds(text: str) -> int:
    """Return a stamp [ns] from seconds as a decimal text, without the loss of a float.

    Raises:
        ValueError: where it isn't a number, or doesn't fit an int64.
    """
    try:
        seconds = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no number of seconds") from None
    if not seconds.is_finite() or not 0 <= seconds < _MAX_S:
        raise ValueError(f"'{text[:40]}' is no stamp")
    stamp_ns = int(seconds.scaleb(9).to_integral_value())
    if stamp_ns > _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no stamp")
    return stamp_ns


def stamp_of_time(text: str) -> int:
    """Return a stamp [ns] from seconds (or, where they are too many, ms, us or ns) since 1970, or a time in ISO 8601.

    Raises:
        ValueError: where it is none of these.
    """
    if "-" in text[1:] and ":" in text:
        found = _of_date(text.strip().replace(" ", "T"))
        if found < 0:
            raise ValueError(f"'{text[:40]}' is no stamp")
        return found
    try:
        value = Decimal(text)
    except InvalidOperation:
        raise ValueError(f"'{text[:40]}' is no time") from None
    if not value.is_finite() or not 0 <= value <= _MAX_NS:
        raise ValueError(f"'{text[:40]}' is no time")
    digits = next(shift for limit, shift in ((11, 9), (14, 6), (17, 3), (19, 0)) if value < Decimal(10) ** limit)
    return min(int(value.scaleb(digits).to_integral_value()), _MAX_NS)


def _of_date(text: str) -> int:
    """Return ns since 1970 of a date and time, which is in UTC unless it ends in an offset such as +01:00."""
    zone = _ZONE.search(text)
    ahead_ns = 0
    if zone is not None:
        minutes = 60 * int(zone[2]) + int(zone[3])
        ahead_ns = minutes * 60_000_000_000 * (-1 if zone[1] == "-" else 1)
    local = text.removesuffix("Z") if zone is None else text[: zone.start()]
    return int(np.datetime64(local, "ns").astype(np.int64)) - ahead_ns


def track_number(text: str) -> int:
    """Return a track id for what a file calls an object: whole numbers stay, other texts become a number of their own
    (a digest, so that it depends on nothing else); -1 where there is none.
    """
    text = text.strip()
    if not text:
        return -1
    if text.lstrip("-").isascii() and text.lstrip("-").isdigit() and len(text) < 19:
        return max(int(text), -1)
    digest = blake2b(text.encode("utf-8", "surrogatepass"), digest_size=8).digest()
    return _HASHED + int.from_bytes(digest, "little") % _HASHED


def number(text: str, where: str, column: str) -> float:
    """Return a number, also one that isn't finite.

    Raises:
        LogError: where the text is none.
    """
    try:
        return float(text)
    except ValueError:
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a number") from None


def whole(text: str, where: str, column: str) -> int:
    """Return a whole number that fits an int64.

    Raises:
        LogError: where the text is none.
    """
    value = number(text, where, column)
    if not (abs(value) < 2**53 and value == int(value)):
        raise LogError(f"{where}: {column} is '{text[:40]}', expected a whole number")
    return int(value)
