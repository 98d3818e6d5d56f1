import numpy as np
import pytest

from fbench.pipelines.sensors.lidar.classification import FEATURES, RoadUserModel, interpolation_weights, load_model


def test_weights_between_knots():
    weights = interpolation_weights(np.array([-1.0, 0.0, 0.5, 1.0, 2.5, 4.0, 9.0]), np.array([0.0, 1.0, 4.0]))
    expected = [[1, 0, 0], [1, 0, 0], [0.5, 0.5, 0], [0, 1, 0], [0, 0.5, 0.5], [0, 0, 1], [0, 0, 1]]
    np.testing.assert_allclose(weights, expected)


def test_probabilities_of_a_small_model():
    """Two classes; the first feature alone matters, and with a low ceiling less: log-odds of 0 and log 2 at 0, of log 3
    and log 2 at 1; with a low ceiling of 0 and log 2.
    """
    knots = tuple(np.array([0.0, 1.0]) for _ in FEATURES)
    none = np.zeros((2, 2, 2))
    log_odds = (np.array([np.zeros((2, 2)), [[0.0, np.log(3)], [0.0, 0.0]]]), *(none for _ in FEATURES[1:]))
    ceilings_m, offset = np.array([1.0, 3.0]), np.array([0.0, np.log(2)])
    model = RoadUserModel(np.array(["car", "truck"]), knots, ceilings_m, log_odds, offset)
    features = np.zeros((4, len(FEATURES)))
    features[1:, 0] = 5.0
    root = np.sqrt(3)  # Halfway between the ceilings its log-odds are half as much
    np.testing.assert_allclose(
        model.probabilities(features, np.array([9.0, 9.0, -9.0, 2.0])),
        [[1 / 4, 2 / 4], [3 / 6, 2 / 6], [1 / 4, 2 / 4], [root / (3 + root), 2 / (3 + root)]],
    )


def test_the_fitted_model_gives_probabilities_whatever_the_features():
    random = np.random.default_rng(0)
    model = load_model()
    for scale in (0.0, 1.0, 1e3, 1e30):
        found = model.probabilities(random.normal(0, scale, (200, len(FEATURES))), random.normal(0, scale, 200))
        assert found.shape == (200, len(model.labels))
        assert (found >= 0).all()
        assert found.sum(axis=1).max() <= 1 + 1e-12
    assert model.probabilities(np.zeros((0, len(FEATURES))), np.zeros(0)).shape == (0, len(model.labels))


HIGH_M = np.array([5.0])


def car(**changes):
    seen = {"length_m": 1.8, "width_m": 0.4, "top_m": 1.4, "reach_m": 1.7, "bottom_m": 0.25, "log2_points": 6.0,
            "filling_m": 0.05, "upper_share": 0.4, "over_share": 0.0, "near_share": 0.0}  # fmt: skip
    return np.array([[{**seen, **changes}[name] for name in FEATURES]])


def test_the_fitted_model_knows_a_car():
    model = load_model()
    probability = model.probabilities(car(), HIGH_M)[0]
    assert probability.sum() > 0.8
    assert model.labels[probability.argmax()] == "car"


@pytest.mark.parametrize(
    "changes",
    [
        {"length_m": 14.0, "width_m": 0.2},
        {"top_m": 5.0, "reach_m": 5.2, "over_share": 0.6},
        {"top_m": 3.0, "reach_m": 3.1, "width_m": 2.0, "filling_m": 0.6},
    ],
    ids=["a long wall", "a facade", "a tree"],
)
def test_other_things_are_less_likely(changes):
    model = load_model()
    assert model.probabilities(car(**changes), HIGH_M).sum() < 0.5 < model.probabilities(car(), HIGH_M).sum()


def test_what_may_go_on_above_the_highest_beam_is_less_surely_a_car():
    """A face as high as a car's rear: a LiDAR that looks over it sees that it ends there, one that doesn't can't tell
    it from a wall.
    """
    face = car(length_m=2.0, width_m=0.2, top_m=1.2, reach_m=1.25, log2_points=8.0, upper_share=0.5)
    model = load_model()
    assert model.probabilities(face, np.array([1.2])).sum() < 0.5 < model.probabilities(face, HIGH_M).sum()
