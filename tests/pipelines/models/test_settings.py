import numpy as np
import pytest

from fbench.pipelines.models.settings import chances


def test_recordings_have_their_share_beside_simulated_logs():
    found = chances(np.array([1.0, 3.0, 2.0, 2.0]), [False, False, True, True], 0.6)
    np.testing.assert_allclose(found, [0.1, 0.3, 0.3, 0.3])


@pytest.mark.parametrize("is_recorded", [True, False])
def test_alone_samples_are_drawn_by_their_weights(is_recorded):
    found = chances(np.array([1.0, 3.0]), [is_recorded] * 2, 0.6)
    assert found.tolist() == [0.25, 0.75]
