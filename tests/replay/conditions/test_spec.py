"""Conditions as texts and TOML files: what they mean, and what is said of those that mean nothing."""

import pytest

from fbench.replay.conditions.spec import load_condition, parse_conditions, split_name, with_absolute_files
from fbench.replay.contracts.errors import ConfigError, RunError


def parse(text):
    return [(p.name, p.sensors, p.strength, p.from_ns, p.to_ns) for p in parse_conditions(text)]


S = 10**9


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("fog", [("fog", "", "3", None, None)]),
        ("fog:1", [("fog", "", "1", None, None)]),
        ("fog:03", [("fog", "", "3", None, None)]),
        ("lidar.fog:2", [("fog", "lidar", "2", None, None)]),
        ("fog.lidar:2", [("fog", "lidar", "2", None, None)]),
        ("dropout.radar_front:1", [("dropout", "radar_front", "1", None, None)]),
        ("lidar.fog.lidar_top:1", [("fog", "lidar_top", "1", None, None)]),
        ("object.moved.lidar:4", [("object.moved", "lidar", "4", None, None)]),
        ("rain:25mmh", [("rain", "", "25mmh", None, None)]),
        ("loss.radar:12.5%@1.5s-3s", [("loss", "radar", "12.5%", 1_500_000_000, 3 * S)]),
        ("fog:2@5s-", [("fog", "", "2", 5 * S, None)]),
        ("fog@-8s", [("fog", "", "3", None, 8 * S)]),
        ("fog:2 + night+loss:1", [("fog", "", "2", None, None), ("night", "", "3", None, None),
                                  ("loss", "", "1", None, None)]),
        ("clear", []),
        ("fog:0", []),
        ("clear+fog:0+night:1", [("night", "", "1", None, None)]),
    ],
)  # fmt: skip
def test_text(text, expected):
    assert parse(text) == expected


def test_a_value_replaces_the_first_number_and_the_others_are_those_of_severity_3():
    assert parse_conditions("rain:25mmh")[0].level == {"rain_mm_h": 25.0}
    assert parse_conditions("extrinsic:0.3deg")[0].level == {"rotated_deg": 0.3, "shifted_m": 0.1}
    assert parse_conditions("loss:30%")[0].level == {"lost_share": 0.3}
    assert parse_conditions("dropout:250s")[0].level == {"silent_s": 250.0}
    assert parse_conditions("delay:7ms")[0].level == {"delay_ms": 7.0}
    assert parse_conditions("drift:40ppm")[0].level == {"fast_ppm": 40.0}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fogg:3", ["unknown condition 'fogg'", "did you mean 'fog'?"]),
        ("lidar.fogg:3", ["unknown condition 'lidar.fogg'", "did you mean 'lidar.fog'?"]),
        ("fog:6", ["'fog:6'", "severity of 0 to 5"]),
        ("fog:-1", ["'fog:-1'"]),
        ("fog:x", ["'fog:x'"]),
        ("fog:25mmh", ["'fog:25mmh'", "such as 150m"]),
        ("rain:150m", ["such as 10mmh"]),
        ("loss:3m", ["such as 20%"]),
        ("loss:150%", ["at most 100%"]),
        ("reorder:3s", ["severity of 0 to 5"]),
        ("fog@", ["expected a window such as @5s-8s"]),
        ("fog@-", ["expected a window"]),
        ("fog:3@8s-5s", ["--condition fog:3 @8s-5s", "the window begins at 8 s, so it can't end at 5 s"]),
        ("fog:3@2s-2s", ["the window begins at 2 s, so it can't end at 2 s"]),
        ("fog:0m", ["--condition fog:0m: Weather.visibility_m: expected 10 to 100000, got 0.0"]),
        ("fog@5-8", ["expected a window"]),
        ("fog++night", ["unknown condition ''"]),
        ("nothere.py:Fog:1", ["nothere.py: no such file"]),
        ("nothere.toml", ["nothere.toml: no such file"]),
    ],
)
def test_errors_are_one_line(text, words):
    with pytest.raises(ConfigError) as found:
        parse_conditions(text)
    assert [word for word in words if word not in str(found.value)] == []
    assert "\n" not in str(found.value)
    assert found.value.exit_code == 2


def test_file(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(
        'version = 1\n[[conditions]]\nname = "fog"\nseverity = 2\n'
        '[[conditions]]\nname = "loss"\nvalue = "30%"\nsensors = "radar*"\nfrom_s = 1.5\nto_s = 3.0\n'
        '[[conditions]]\nname = "rain"\nseverity = 0\n[[conditions]]\nname = "lidar.snow"\n'
    )
    assert parse(str(path)) == [
        ("fog", "", "2", None, None), ("loss", "radar*", "30%", 1_500_000_000, 3 * S),
        ("snow", "lidar", "3", None, None),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("version = 1\n[[conditions]\n", ["isn't TOML", "2"]),
        ("version = 2\nconditions = []\n", ["version"]),
        ('version = 1\n[[conditions]]\nname = "fog"\nsevrity = 2\n', ["conditions.0.sevrity"]),
        ('version = 1\n[[conditions]]\nname = "fog"\nseverity = 6\n', ["conditions.0.severity", "5"]),
        ('version = 1\n[[conditions]]\nname = "fog"\nseverity = "2"\n', ["conditions.0.severity"]),
        ("version = 1\n[[conditions]]\nseverity = 2\n", ["conditions.0.name"]),
        ('version = 1\n[[conditions]]\nname = "fog"\nfrom_s = -1.0\n', ["conditions.0.from_s"]),
        ('version = 1\n[[conditions]]\nname = "fog"\nfrom_s = nan\n', ["conditions.0.from_s"]),
        (
            'version = 1\n[[conditions]]\nname = "fog"\nfrom_s = 3.0\nto_s = 2.0\n',
            ["the window begins at 3 s, so it can't end at 2 s"],
        ),
        ('version = 1\n[[conditions]]\nname = "fog"\nseverity = 1\nvalue = "90m"\n', ["either severity or value"]),
        ('version = 1\n[[conditions]]\nname = "lidar.fog"\nsensors = "radar"\n', ["names sensors already"]),
        ('version = 1\n[[conditions]]\nname = "fogg"\n', ["did you mean 'fog'"]),
        ('version = 1\n[[conditions]]\nname = "mine.py:Dust"\n', ["runs code; name it on the command line"]),
        ("version = 1\n", ["conditions"]),
    ],
)
def test_wrong_files_name_the_key(tmp_path, content, words):
    path = tmp_path / "bad.toml"
    path.write_text(content)
    with pytest.raises(ConfigError) as found:
        parse_conditions(str(path))
    assert [word for word in [str(path), *words] if word not in str(found.value)] == []
    assert "\n" not in str(found.value)


def test_split_name_says_what_a_name_means():
    assert split_name("lidar.fog") == ("fog", "lidar")
    assert split_name("object.cutout") == ("object.cutout", "")
    assert split_name("a.b/dust.py:Dust.lidar_top") == ("a.b/dust.py:Dust", "lidar_top")


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("class Bad:\n    version = 1\n", "lacks kinds, levels"),
        ("class Bad:\n    version, kinds, levels = 1, ('lidar',), {'a': (1, 2)}\n    disturb = print\n", "expected 5"),
        ("class Bad:\n    version, kinds, levels = 1, ('lidar',), 3\n    disturb = print\n", "five numbers by name"),
        ("class Bad:\n    version, kinds, levels = 1, ('lidar',), {}\n", "lacks disturb()"),
        ("class Bad:\n    def __init__(self):\n        raise ValueError('no')\n", "can't be made: ValueError: no"),
        ("import nothing_like_this\n", "can't be imported"),
    ],
)  # fmt: skip
def test_classes_that_are_no_conditions(tmp_path, body, words):
    file = tmp_path / "bad.py"
    file.write_text(body)
    with pytest.raises(ConfigError, match=words.replace("(", r"\(").replace(")", r"\)")):
        load_condition(f"{file}:Bad")


def test_weather_that_raises_is_one_line(tmp_path):
    file = tmp_path / "bad.py"
    body = "class Bad:\n    version, kinds, levels = 1, ('lidar',), {'a': (1, 2, 3, 4, 5)}\n    disturb = print\n"
    file.write_text(body + "    def weather(self, level): return 1 / 0\n")
    with pytest.raises(RunError, match="has no weather: ZeroDivisionError: division by zero"):
        parse_conditions(f"{file}:Bad:3")


def test_files_are_found_from_any_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert with_absolute_files("x.toml") == str(tmp_path / "x.toml")
    assert with_absolute_files("fog:3+my/dust.py:Dust:2@1s-") == f"fog:3+{tmp_path}/my/dust.py:Dust:2@1s-"
    assert with_absolute_files("fog:3") == "fog:3"
