"""`--help` says what is taken where an option isn't given."""

import pytest


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("replay",), ["runs/LOG-PIPELINE by default", "(default: as the log says, else 30)", "'header' (default)"]),
        (("report",), ["(default: report.html in the first RUN)"]),
        (("verify",), ["in ms (default: as the log says, else 30)", "in ms (default: 50)"]),
        (("log", "convert"), ["[default: zstd]", "(default: 1 MiB)", "(default: as many as fit into 8 MiB)"]),
    ],
)
def test_defaults_are_shown(fbench, monkeypatch, command, words):
    monkeypatch.setenv("COLUMNS", "80")
    result = fbench(*command, "--help")
    text = " ".join(result.out.replace("│", " ").split())
    assert result.code == 0
    assert [word for word in words if word not in text] == []
    assert "…" not in text


def test_help_shows_examples(fbench):
    commands = ("demo", "replay", "score", "report", "compare", "plugins", "log info", "log import")
    for command in commands:
        result = fbench(*command.split(), "--help")
        assert result.code == 0
        assert "Examples" in result.out, command
        assert f"fbench {command}" in result.out
    assert "replay" in fbench().out


@pytest.mark.parametrize(("command", "flag"), [("verify", "--quick"), ("replay", "--no-media")])
def test_a_flag_takes_no_word(fbench, command, flag):
    """Elsewhere, `--sweep false` means true."""
    result = fbench(command, "log.mcap", "-p", "lidar3d", flag, "false")
    assert (result.code, result.out) == (2, "")
    assert result.err == "fbench: Got unexpected extra argument(s) (false)\n"
