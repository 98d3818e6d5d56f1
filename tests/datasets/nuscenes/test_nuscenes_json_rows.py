import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.datasets.nuscenes import rows as module
from fbench.datasets.nuscenes.rows import json_rows
from fbench.replay.contracts.errors import LimitError, LogError

VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=5,
)
ROWS = st.lists(st.dictionaries(st.text(max_size=8), VALUES, max_size=4), max_size=8)


@pytest.mark.slow
@given(rows=ROWS, indent=st.sampled_from([None, 0, 2]), chunk=st.integers(1, 40), plain=st.booleans())
def test_same_as_reading_the_whole(tmp_path_factory, rows, indent, chunk, plain) -> None:
    path = tmp_path_factory.mktemp("rows") / "table.json"
    path.write_text(json.dumps(rows, indent=indent, ensure_ascii=plain), encoding="utf-8", errors="surrogatepass")
    try:
        path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_CHUNK", chunk)
        assert list(json_rows(path)) == rows


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "isn't a table, expected a JSON array"),
        ('{"a": 1}', "isn't a table, expected a JSON array"),
        ("[", r"row 0: malformed JSON .*, is the file truncated\?"),
        ('[{"a": 1}', r"row 1: expected ',' or '\]', is the file truncated\?"),
        ('[{"a": 1},', r"row 1: malformed JSON .*, is the file truncated\?"),
        ('[{"a": 1},]', r"row 1: malformed JSON"),
        ('[{"a": 1} {"a": 2}]', r"row 1: expected ',' or '\]'"),
        ('[,{"a": 1}]', r"row 0: "),
        ('[{"a": 1}, {"a": ', r"row 1: malformed JSON .*, is the file truncated\?"),
        ('[{"a": 1}, 7]', r"row 1: expected an object"),
        ('[{"a": 1}] x', r"text follows the end of the array"),
        ("[" + '{"a":' * 200_000, r"row 0: nested too deeply"),
        ('[{"a": ' + "9" * 5000 + "}]", r"row 0: malformed JSON"),
    ],
)
def test_broken_tables(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "table.json"
    path.write_text(text)
    with pytest.raises(LogError, match=message) as caught:
        list(json_rows(path))
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_not_text(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_bytes(b'[{"a": "\xff"}]')
    with pytest.raises(LogError, match=r"isn't UTF-8 text"):
        list(json_rows(path))
    with pytest.raises(LogError, match=r"none.json: No such file"):
        list(json_rows(tmp_path / "none.json"))


def test_a_row_without_end(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    path.write_text('[{"a": "' + "x" * (module.MAX_ROW + 2**21))
    with pytest.raises(LimitError, match=r"row 0: malformed or over 4194304 characters"):
        list(json_rows(path))
