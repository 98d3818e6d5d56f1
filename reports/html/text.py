"""Text and numbers as a page shows them, and data as a script may read them. Everything here is untrusted input."""

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

DASH = "–"

_INVISIBLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff]"
)
_SCRIPT_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&'\u2028\u2029"}


def visible(text: str) -> str:
    """Write control, direction and other invisible characters as `\\x1b`, so that they neither act nor hide."""
    return _INVISIBLE.sub(lambda m: _code(m[0]), text)


def _code(char: str) -> str:
    return f"\\x{ord(char):02x}" if ord(char) < 256 else f"\\u{ord(char):04x}"


def number(value: float | None, digits: int = 3) -> str:
    """Format with a true minus sign; an en dash for `None` and what isn't finite."""
    if value is None or not math.isfinite(value):
        return DASH
    text = f"{value:,.{digits}f}".replace(",", "\u202f")
    return text.replace("-", "\u2212") if float(f"{value:.{digits}f}") else text.replace("-", "")


def brief(text: str, length: int = 12) -> str:
    """Return the first characters of a digest."""
    return text[:length]


def rounded(value: Any, digits: int = 3) -> Any:
    """Round floats for display, at any depth; NaN and infinities become `None`, strings visible."""
    if isinstance(value, float):
        return round(value, digits) + 0.0 if math.isfinite(value) else None
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, Mapping):
        return {visible(str(k)): rounded(v, digits) for k, v in value.items()}
    if isinstance(value, Sequence):
        return [rounded(v, digits) for v in value]
    return value


def island(value: Any) -> str:
    """Encode as JSON that is safe inside a `<script type="application/json">`: nothing in it can end the element."""
    text = json.dumps(rounded(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.translate(_SCRIPT_ESCAPES)
