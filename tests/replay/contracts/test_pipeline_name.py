"""How pipelines are written, and what their folders are called."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.plugins import make_pipeline, open_pipeline, parse_name, with_absolute_files


@pytest.mark.parametrize(
    ("text", "plugin", "argument", "short"),
    [
        ("lidar3d", "lidar3d", None, "lidar3d"),
        ("mine.py:Mine", "mine.py:Mine", None, "mine-Mine"),
        ("../some dir/mine.py:Mine", "../some dir/mine.py:Mine", None, "mine-Mine"),
        ("exec:./my_stack --arg", "exec", "./my_stack --arg", "my_stack"),
        ("exec:/opt/x/bin/stack -c a.yaml", "exec", "/opt/x/bin/stack -c a.yaml", "stack"),
        ("exec:python3 mine.py:8 x", "exec", "python3 mine.py:8 x", "python3-mine-x"),
        ("exec:ros2 run pkg node --ros-args", "exec", "ros2 run pkg node --ros-args", "ros2-run-pkg-node"),
        ("exec:'my stack' 'unclosed", "exec", "'my stack' 'unclosed", "my_stack_unclosed"),
        ("exec:", "exec", "", "exec"),
        ("recorded:/perception/objects", "recorded", "/perception/objects", "recorded-perception_objects"),
    ],
)
def test_names(text, plugin, argument, short):
    name = parse_name(text)
    assert (name.plugin, name.argument, name.short) == (plugin, argument, short)
    assert str(name) == text


def test_files_in_commands_become_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stack").touch()
    (tmp_path / "a b.yaml").touch()
    (tmp_path / "link.py").symlink_to("/etc/hostname")
    assert with_absolute_files("./stack -c 'a b.yaml' fast") == f"{tmp_path}/stack -c '{tmp_path}/a b.yaml' fast"
    assert with_absolute_files("./link.py") == f"{tmp_path}/link.py"
    assert with_absolute_files("stack  'x'  0.6") == "stack  'x'  0.6"


WITH_ARGUMENT = """
from dataclasses import dataclass

@dataclass(frozen=True)
class Params:
    word: str = ""

class Talks:
    argument = "word"
    log = []

    def __init__(self, params: Params = Params()): self.params = params
    def start(self, rig, log_info): pass
    def reset(self, reason): pass
    def step(self, frame): pass
    def close(self): self.log.append("closed")
"""


def test_pipelines_are_closed_after_errors_too(tmp_path):
    path = tmp_path / "talks.py"
    path.write_text(WITH_ARGUMENT)
    with open_pipeline(f"{path}:Talks", ["word=x"]) as (pipeline, parameters):
        assert parameters == {"word": "x"}
        log = vars(type(pipeline))["log"]
        assert log == []
    assert log == ["closed"]
    failing = open_pipeline(f"{path}:Talks", [])
    log = vars(type(failing.__enter__()[0]))["log"]
    assert not failing.__exit__(KeyError, KeyError(), None)
    assert log == ["closed"]


def test_argument_where_none_is_taken():
    with pytest.raises(ConfigError, match="pipeline 'lidar3d' takes nothing behind a colon, got 'lidar3d:fast'"):
        make_pipeline("lidar3d:fast", [])
    with pytest.raises(ConfigError, match="unknown pipeline 'lidar4d'; did you mean 'lidar3d'"):
        make_pipeline("lidar4d:fast", [])
