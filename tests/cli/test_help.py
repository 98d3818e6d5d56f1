"""`--help` says what is taken where an option isn't given."""

import pytest


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("replay",), ["else runs/LOG-PIPELINE", "in ms; else 30,", "(by default)"]),
        (("report",), ["else report.html in the first RUN"]),
        (("verify",), ["in ms; else 30,", "in ms; else 50."]),
        (("log", "convert"), ["[default: zstd]", "else 1 MiB", "else as many as make 8 MiB"]),
    ],
)
def test_defaults_are_shown(fbench, monkeypatch, command, words):
    monkeypatch.setenv("COLUMNS", "80")
    result = fbench(*command, "--help")
    text = " ".join(result.out.replace("│", " ").split())
    assert result.code == 0
    assert [word for word in words if word not in text] == []
    assert "…" not in text
