import numpy as np

from baselines.delta_transfer import DeltaTransfer
from tests.synthetic import problem


def test_adds_the_displacement_by_hand():
    given = problem()
    frame = given.source_neutral.copy()
    frame[7] += [1, -2, 3]
    moved = DeltaTransfer().retarget(given, frame[None]).frames[0] - given.target_neutral
    np.testing.assert_allclose(moved[7], [1, -2, 3], atol=1e-12)
    assert np.abs(np.delete(moved, 7, axis=0)).max() < 1e-12
