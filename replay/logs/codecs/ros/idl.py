"""Definitions in IDL, as rosbag2 stores those of packages without .msg files: turned into .msg texts, one a struct.

Reads what ROS allows of IDL (https://design.ros2.org/articles/idl_interface_definition.html): modules, structs,
typedefs, constants, annotations. Each token is looked at once, because the text is untrusted.
"""

import re
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from fbench.replay.contracts.errors import DecodeError

MAX_BYTES = 512 * 1024  # Comments are part of it, as annotations
_SECTION = re.compile(r"^={80}\r?\nIDL: .*$", re.MULTILINE)
"""Before each definition: https://github.com/ros2/rosbag2/blob/rolling/docs/message_definition_encoding.md."""
_TOKEN = re.compile(
    r"(?P<skip>\s+|//[^\n]*|/\*.*?\*/|\#[^\n]*)"
    r'|(?P<text>L?"(?:[^"\\]|\\.)*"|L?\'(?:[^\'\\]|\\.)*\')'
    r"|(?P<open>/\*|[\"'])"
    r"|(?P<word>(?:::)?[A-Za-z_]\w*(?:::[A-Za-z_]\w*)*)"
    r"|(?P<other>[0-9][\w.]*|.)",
    re.DOTALL | re.ASCII,
)
_PLAIN: Mapping[str, str] = {
    "boolean": "bool", "octet": "uint8", "char": "uint8", "float": "float32", "double": "float64", "string": "string",
    "int8": "int8", "uint8": "uint8", "int16": "int16", "uint16": "uint16", "int32": "int32", "uint32": "uint32",
    "int64": "int64", "uint64": "uint64", "short": "int16", "long": "int32", "long long": "int64",
    "unsigned short": "uint16", "unsigned long": "uint32", "unsigned long long": "uint64",
}  # fmt: skip
"""Types of .msg by those of IDL; what has several words is a number."""
_NUMBER_WORDS = ("unsigned", "short", "long", "double")
_MAX_MODULES = 4  # In each other; ROS has two, and one more for constants


class _Type(NamedTuple):
    """Type of a field as .msg has it."""

    name: str
    array: str = ""  # `[]` or `[N]`


def idl_texts(data: bytes) -> dict[str, str]:
    """Return the .msg text of each struct by its full name, `pkg/msg/Name`. Raises DecodeError where the definition is
    too large, or isn't IDL as ROS has it.
    """
    if len(data) > MAX_BYTES:
        raise DecodeError(f"definition in IDL has {len(data)} bytes, more than {MAX_BYTES}")
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise DecodeError(f"definition in IDL isn't UTF-8 ({error})") from error
    found: dict[str, str] = {}
    for part in _SECTION.split(text):
        parser = _Parser(part)
        parser.read_file()
        found |= parser.found
    return found


def _tokens(text: str) -> Iterator[str]:
    for match in _TOKEN.finditer(text):
        if match.lastgroup == "open":
            raise DecodeError(f"definition in IDL has a {match[0]} without its end")
        if match.lastgroup != "skip":
            yield match[0]
    while True:  # behind the end, whatever is expected isn't there
        yield ""


class _Parser:
    """Reads one file; `found` are the .msg texts by name."""

    def __init__(self, text: str) -> None:
        self.found: dict[str, str] = {}
        self._rest = _tokens(text)
        self._next = next(self._rest)
        self._types: dict[str, _Type] = {}  # Of typedefs, by full name

    def read_file(self) -> None:
        """Read all definitions. Raises DecodeError where one isn't as expected."""
        self._read_definitions(())
        if self._next:
            raise self._wrong("the end")

    def _read_definitions(self, modules: tuple[str, ...]) -> None:
        while self._next not in ("", "}"):
            match self._next:
                case ";":
                    self._take()
                case "@":
                    self._skip_annotation()
                case "module":
                    self._read_module(modules)
                case "struct":
                    self._read_struct(modules)
                case "typedef":
                    self._take()
                    base = self._read_type(modules)
                    name, array = self._read_declarator()
                    self._types["::".join((*modules, name))] = self._join(base, array)
                    self._take(";")
                case "const":
                    while self._next not in (";", ""):
                        self._take()
                    self._take(";")
                case _:
                    raise self._wrong("a module, struct, typedef or constant")

    def _read_module(self, modules: tuple[str, ...]) -> None:
        self._take("module")
        if len(modules) == _MAX_MODULES:
            raise DecodeError(f"definition in IDL has more than {_MAX_MODULES} modules in each other")
        name = self._take_name()
        self._take("{")
        self._read_definitions((*modules, name))
        self._take("}")

    def _read_struct(self, modules: tuple[str, ...]) -> None:
        self._take("struct")
        name, lines = self._take_name(), list[str]()
        self._take("{")
        while self._next != "}":
            if self._next == "@":
                self._skip_annotation()
                continue
            base = self._read_type(modules)
            while True:
                field, array = self._read_declarator()
                kind = self._join(base, array)
                lines.append(f"{kind.name}{kind.array} {field}\n")
                if self._next != ",":
                    break
                self._take()
            self._take(";")
        self._take("}")
        self.found["/".join((*modules, name))] = "".join(lines)

    def _read_type(self, modules: tuple[str, ...], *, in_sequence: bool = False) -> _Type:
        word = self._take_name()
        if word == "sequence":
            if in_sequence:
                raise DecodeError("definition in IDL has a sequence of sequences")
            self._take("<")
            inner = self._read_type(modules, in_sequence=True)
            if self._next == ",":
                self._take()
                self._take()
            self._take(">")
            return self._join(inner, "[]")
        if word in ("string", "wstring") and self._next == "<":
            for expected in ("<", None, ">"):
                self._take(expected)
        if word in _NUMBER_WORDS:
            words = [word]
            while self._next in _NUMBER_WORDS:
                words.append(self._take())
            word = " ".join(words)
        if word in _PLAIN:
            return _Type(_PLAIN[word])
        if word in ("wstring", "wchar", "any", "map", "fixed") or " " in word:
            raise DecodeError(f"definition in IDL has a '{word}', which isn't read")
        return self._resolve(word.removeprefix("::"), modules)

    def _resolve(self, name: str, modules: tuple[str, ...]) -> _Type:
        """The type that a name means in these modules: of a typedef, else of a struct."""
        scopes = ["::".join((*modules[:num], name)) for num in range(len(modules), -1, -1)]
        known = next((self._types[scope] for scope in scopes if scope in self._types), None)
        if known is not None:
            return known
        parts = name.split("::") if "::" in name else [*modules, name]
        return _Type("/".join(part for i, part in enumerate(parts) if (i, part) != (1, "msg")))

    def _read_declarator(self) -> tuple[str, str]:
        """Name of a field or type, and the array that it is."""
        name, array = self._take_name(), ""
        if self._next == "[":
            self._take()
            array = f"[{self._take()}]"
            self._take("]")
        return name, array

    def _join(self, base: _Type, array: str) -> _Type:
        if base.array and array:
            raise DecodeError(f"definition in IDL has arrays of arrays, of {base.name}{base.array}")
        if array not in ("", "[]") and not array[1:-1].isdecimal():
            raise DecodeError(f"definition in IDL has an array of '{array[1:-1][:80]}'")
        return _Type(base.name, base.array or array)

    def _skip_annotation(self) -> None:
        self._take("@")
        self._take_name()
        depth = 0
        while self._next == "(" or depth:
            depth += {"(": 1, ")": -1}.get(self._take(), 0)
            if not self._next:
                raise self._wrong("')'")

    def _take_name(self) -> str:
        if not re.match(r"(?:::)?[A-Za-z_]", self._next):
            raise self._wrong("a name")
        return self._take()

    def _take(self, expected: str | None = None) -> str:
        """Go on to the next token. Raises DecodeError where this one isn't the expected one, or there is none."""
        token = self._next
        if not token or expected not in (None, token):
            raise self._wrong(f"'{expected}'" if expected else "more")
        self._next = next(self._rest)
        return token

    def _wrong(self, expected: str) -> DecodeError:
        return DecodeError(f"definition in IDL isn't as expected: '{self._next[:80]}' instead of {expected}")
