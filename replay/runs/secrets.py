"""Removal of credentials, queries and secret values from texts.

Names of files, metadata of logs, commands and texts of exceptions are written by others, and any of them may hold a
signed URL; so all that a run keeps, and every error, goes through here. It rather removes too much than too little.
Every scan is bounded or goes on behind what it has read, so that time grows with the length of a text alone.
"""

import re
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

HIDDEN = "***"
_HINT = re.compile(r"[@?=#]|:[/\\]|%|-|secret|token|pass|pwd|key|auth|cred|sig|bearer|cookie", re.IGNORECASE)
_SLASHES = r"(?:/|\\|%(?:25){0,4}(?:2F|5C)){1,8}"
_START = re.compile(rf"(:|%(?:25){{0,4}}3A){_SLASHES}", re.IGNORECASE)
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*\Z")
_MAX_SCHEME = 32
_KNOWN = frozenset((
    "abfs", "abfss", "adl", "amqp", "amqps", "azure", "dav", "davs", "ftp", "ftps", "gcs", "git", "gs", "hdfs", "http",
    "https", "mongodb", "mqtt", "mysql", "nats", "oss", "postgres", "postgresql", "redis", "rediss", "rtmp", "rtmps",
    "rtsp", "rtsps", "s3", "s3a", "s3n", "sftp", "smb", "ssh", "svn", "swift", "wasb", "wasbs", "webhdfs", "ws", "wss",
))  # fmt: skip
"""Schemes that count even where a path has lost one of the two slashes."""
_ESCAPE = re.compile("%[0-9A-Fa-f]{2}")
_HOST_END = re.compile(r"""[\s/?#\\]|["'`](?![A-Za-z0-9%_-])""")
_HOST_END_ESCAPED = re.compile(rf"{_HOST_END.pattern}|%(?:25){{0,4}}(?:2F|3F|23)", re.IGNORECASE)
_AT = re.compile("@|%(?:25){0,4}40", re.IGNORECASE)
_PORT = re.compile(r"(?:\[[^\]]*\]|[^:\[\]]*)(?::[0-9]*)?")
_QUERY = re.compile("[?#]|%(?:25){0,4}(?:3F|23)", re.IGNORECASE)
_LOOSE_QUERY = re.compile(r"(?:\?|%(?:25){0,4}3F)[\w.~-]{1,64}(?:=|%(?:25){0,4}3D)", re.IGNORECASE)
_END = re.compile(r"""\s|["'`](?=[\s,;:)\]}>|\\]|\Z)""")
_BEFORE_AT = 320
_BREAK = re.compile(r"""[\s/\\"'`<>@]""")

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9_.-]*+")
_PART = re.compile("[A-Z]+(?![a-z])|[A-Z]?[a-z]+")
_ALWAYS = (
    "password", "passwd", "passphrase", "secret", "secrets", "credential", "credentials", "signature", "authorization",
    "apikey", "accesskey", "accountkey", "secretkey", "privatekey", "signingkey", "sharedkey",
)  # fmt: skip
_AS_LAST = ("token", "sig", "auth", "pwd", "sas", "jwt", "cookie")
_KEYS = ("api", "access", "account", "private", "secret", "signing", "shared", "encryption", "auth", "master", "ssh")
_GIVEN = re.compile(r"""["']?\s{0,3}(?:=|:(?![/\\])|%(?:25){0,4}3D)\s{0,3}""", re.IGNORECASE)
_NEXT_WORD = re.compile(r"""["']?,?\s{1,3}(?!-)""")
_VALUE = re.compile(
    r"""(?:bearer|basic|digest|token|negotiate)\s{1,3}(?:\\.|[^\s"'])++
    |"(?:[^"\\]|\\.)*+"? | '(?:[^'\\]|\\.)*+'? | (?:\\.|\S)++""",
    re.IGNORECASE | re.VERBOSE | re.DOTALL,
)
_MIN_BEARER = 8


def without_secrets(text: str) -> str:
    """Return a text without credentials, queries and fragments of URLs, and with `***` for what is named a secret."""
    if _HINT.search(text) is None:
        return text
    return _without_named(_without_bare(_without_queries(_without_users(text))))


_NO_CHARACTERS = re.compile("[\ud800-\udfff]")


def readable(text: str) -> str:
    """Return a text that any file can hold: what isn't Unicode in the name of a file becomes `_`."""
    return _NO_CHARACTERS.sub("_", text)


def clean_mapping(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return a mapping whose keys and texts hold no secrets, and only Unicode; texts under names like `api_key` are
    hidden whole.
    """
    cleaned: dict[str, Any] = {}
    for key, value in values.items():
        hidden = isinstance(value, str) and value != "" and is_secret_name(key)
        cleaned.setdefault(readable(without_secrets(key)), HIDDEN if hidden else _clean(value))
    return cleaned


def _clean(value: Any) -> Any:
    if isinstance(value, str):
        return readable(without_secrets(value))
    if isinstance(value, Mapping):
        return clean_mapping(value)
    return [_clean(item) for item in value] if isinstance(value, list | tuple) else value


def is_secret_name(name: str) -> bool:
    """Tell whether an option, variable or key is called like something secret: `AWS_SECRET_ACCESS_KEY`, `--apiKey`."""
    parts = [part.lower() for part in _PART.findall(name[-200:])]
    if not parts:
        return False
    if any(part.endswith(_ALWAYS) for part in parts) or parts[-1].endswith("token") or parts[-1] in _AS_LAST:
        return True
    return any(key == "key" and kind in _KEYS for kind, key in pairwise(parts))


def _without_users(text: str) -> str:
    """Remove what stands before the `@` of each URL's host, also within the path of another."""
    pieces: list[str] = []
    done = no_at_until = 0
    for start in _starts(text):
        at = start.end()
        if at < done:
            continue
        is_plain = start[1] == ":"
        stop = (_HOST_END if is_plain else _HOST_END_ESCAPED).search(text, at)
        host_end = len(text) if stop is None else stop.start()
        signs = list(_AT.finditer(text, at, host_end))
        if not signs and host_end >= no_at_until and _PORT.fullmatch(text, at, host_end) is None:
            # No port is called so: a password that holds a slash, '?' or '#'.
            end = _end(text, at)
            signs = list(_AT.finditer(text, host_end, end))
            no_at_until = 0 if signs else end
        if signs:
            pieces.append(text[done:at])
            done = signs[-1].end()
    return "".join([*pieces, text[done:]])


def _starts(text: str) -> "list[re.Match[str]]":
    return [found for found in _START.finditer(text) if _is_url(text, found)]


def _is_url(text: str, found: "re.Match[str]") -> bool:
    before = _ESCAPE.split(text[max(0, found.start() - _MAX_SCHEME) : found.start()])[-1]
    scheme = _SCHEME.search(before)
    if scheme is None:
        return False
    num_slashes = len(re.findall(r"[/\\]|2F|5C", found[0], re.IGNORECASE))
    return num_slashes > 1 or scheme[0].rpartition("+")[2].lower() in _KNOWN


def _end(text: str, at: int) -> int:
    end = _END.search(text, at)
    return len(text) if end is None else end.start()


def _without_queries(text: str) -> str:
    """Remove queries and fragments: of URLs, and of what looks like one without its beginning."""
    pieces: list[str] = []
    done = 0
    for at in sorted([*(start.end() for start in _starts(text)), *(q.start() for q in _LOOSE_QUERY.finditer(text))]):
        if at < done:
            continue
        end = _end(text, at)
        query = _QUERY.search(text, at, end)
        pieces.append(text[done : end if query is None else query.start()])
        done = end
    return "".join([*pieces, text[done:]])


def _without_bare(text: str) -> str:
    """Remove `user:password` before an `@`, also where no scheme stands before it."""
    pieces: list[str] = []
    done, last, at = 0, -1, text.find("@")
    while at >= 0:
        word = _BREAK.split(text[max(last + 1, at - _BEFORE_AT) : at])[-1]
        user, colon, password = word.partition(":")
        if user and colon and password and text[at + 1 : at + 2].strip():
            pieces += [text[done : at - len(word)], HIDDEN]
            done = at
        last, at = at, text.find("@", at + 1)
    return "".join([*pieces, text[done:]])


def _without_named(text: str) -> str:
    """Hide `password=...`, `"token": "..."`, `--api-key ...`, `Authorization: Bearer ...`."""
    pieces: list[str] = []
    done = 0
    for word in _WORD.finditer(text):
        if word.start() < done:
            continue
        value = _value(text, word)
        if value is not None:
            pieces += [text[done : value.start()], _hide(value[0])]
            done = value.end()
    return "".join([*pieces, text[done:]])


def _value(text: str, word: "re.Match[str]") -> "re.Match[str] | None":
    """What is given to the name `word`, where that is a secret."""
    if word[0].lower() == "bearer":
        given = _NEXT_WORD.match(text, word.end())
        value = None if given is None else _VALUE.match(text, given.end())
        return None if value is None or len(value[0]) < _MIN_BEARER else value
    if not is_secret_name(word[0]):
        return None
    given = _GIVEN.match(text, word.end())
    if given is not None and ":" in given[0] and text[max(0, word.start() - 1) : word.start()] in ("/", "\\"):
        return None  # the last name of a path, and what is said about it
    if given is None and text[max(0, word.start() - 1) : word.start()] == "-":
        given = _NEXT_WORD.match(text, word.end())
    return None if given is None else _VALUE.match(text, given.end())


def _hide(value: str) -> str:
    """`***`, with the quotes and brackets that don't belong to it."""
    if value[0] in "\"'":
        return f"{value[0]}{HIDDEN}{value[-1] if len(value) > 1 and value[-1] == value[0] else ''}"
    return HIDDEN + value[len(value.rstrip("\"',;)]}")) :]
