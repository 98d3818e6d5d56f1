from dataclasses import dataclass, field

import pytest

from fbench.cli.listing import parameter_docs


@dataclass(frozen=True)
class Inner:
    eps_m: float = 0.6
    """Radius [m]."""
    plain: int = 1
    min_points: int = 5  # Points, itself included.


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    """How."""
    on: bool = True
    """Whether
    at all."""


def test_texts_under_and_beside_fields_are_found_by_dotted_name():
    docs = {"inner.eps_m": "Radius [m].", "inner.plain": "", "inner.min_points": "Points, itself included."}
    assert parameter_docs(Outer()) == docs | {"on": "Whether at all."}
    assert parameter_docs(None) == {}


def test_what_is_true_in_space_alone_isnt_said_of_images():
    from fbench.pipelines.fusion.early.image import EarlyImageParams

    docs = parameter_docs(EarlyImageParams())
    assert docs["echo_shapes"].startswith("Whether shapes of radar echoes count beside a LiDAR")
    assert "space" not in docs["echo_shapes"]


@pytest.mark.slow
def test_every_parameter_of_the_builtin_pipelines_is_documented():
    from fbench.replay.contracts.entry_points import entry_points_of, load
    from fbench.replay.contracts.plugins import default_params

    for name in entry_points_of("pipelines"):
        docs = parameter_docs(default_params(load("pipelines", name)))
        assert docs
        assert [path for path, text in docs.items() if not text] == []
