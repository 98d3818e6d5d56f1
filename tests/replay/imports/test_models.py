"""JSON files of datasets."""

import pytest
from pydantic import BaseModel

from fbench.datasets.importing.files import read_json
from fbench.replay.contracts.errors import LogError


class Box(BaseModel):
    size: tuple[float, float]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"x.json: Invalid JSON: EOF"),
        ('[{"size": [1, 2]}, {"size": [1', r"x.json: Invalid JSON"),
        ("{}", r"x.json: Input should be a valid array$"),
        ('[{"size": [1, 2]}, {}]', r"x.json: 1.size: Field required$"),
        ('[{"size": [1, "a"]}]', r"x.json: 0.size.1: Input should be a valid number"),
        ("[" * 100_000, r"x.json: Invalid JSON: recursion limit"),
    ],
)
def test_what_is_wrong_is_told_with_file_and_field(tmp_path, text, message):
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(LogError, match=message):
        read_json(tmp_path / "x.json", list[Box])


def test_content_comes_as_its_model(tmp_path):
    (tmp_path / "x.json").write_text('[{"size": [1, 2], "other": 3}]')
    assert read_json(tmp_path / "x.json", list[Box]) == [Box(size=(1, 2))]
