"""What a program writes to stderr, kept within a bound."""

_HALF_BYTES = 512 * 1024
_LINE_CHARS = 300
_LINE_BYTES = 4096


class KeptText:
    """Keeps the first and the last part of what is added, and counts what lies between them."""

    def __init__(self, half_bytes: int = _HALF_BYTES) -> None:
        self._half = half_bytes
        self._first, self._last = bytearray(), bytearray()
        self._num = self._mark = 0

    def add(self, data: bytes) -> None:
        """Add what was read."""
        self._num += len(data)
        room = self._half - len(self._first)
        self._first += data[:room]
        self._last += data[room:]
        if len(self._last) > 2 * self._half:
            del self._last[: -self._half]

    def begin(self) -> None:
        """Let `last_line` look only at what comes from here on."""
        self._mark = self._num

    @property
    def last_line(self) -> str:
        """The last line since `begin` that isn't empty, cut to 300 characters; empty where there is none."""
        num = min(self._num - self._mark, _LINE_BYTES)
        tail = (bytes(self._first[-num:]) + bytes(self._last[-num:]))[-num:] if num else b""
        lines = [line.strip() for line in tail.decode(errors="replace").splitlines()]
        return next((line for line in reversed(lines) if line), "")[:_LINE_CHARS]

    def text(self) -> bytes:
        """All that is kept."""
        last = bytes(self._last[-self._half :])
        left_out = self._num - len(self._first) - len(last)
        gap = f"\n[{left_out} bytes left out]\n".encode() if left_out else b""
        return bytes(self._first) + gap + last
