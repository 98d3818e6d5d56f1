"""Short logs of the simulated city that several tests look at."""

import pytest
from tests.datasets.city.city_logs import RIG, Log, simulated


@pytest.fixture(scope="session")
def logs(tmp_path_factory):
    """Simulate a log with the common rig, once a name."""
    folder = tmp_path_factory.mktemp("city")
    rig = folder / "rig.toml"
    rig.write_text(RIG)
    made: dict[str, Log] = {}

    def log(name, *args):
        if name not in made:
            made[name] = simulated(folder, name, *args, "--rig", rig)
        return made[name]

    return log


@pytest.fixture(scope="session")
def urban(logs):
    return logs("urban", "urban", "--seed", 3, "--seconds", 1)


@pytest.fixture(scope="session")
def highway(logs):
    return logs("highway", "highway", "--seed", 4, "--seconds", 1)


@pytest.fixture(scope="session", params=["urban", "highway"])
def log(request):
    """Both."""
    return request.getfixturevalue(request.param)


@pytest.fixture(scope="session")
def under(logs):
    """The beginning of `urban` under another condition."""

    def log(condition, *args):
        name = "-".join([condition, *map(str, args)]).replace("--", "").replace("=", "")
        return logs(name, "urban", "--seed", 3, "--seconds", 0.25, "--condition", condition, *args)

    return log
