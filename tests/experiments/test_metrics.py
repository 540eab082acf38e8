import numpy as np
import pytest

from experiments.metrics.metric import Comparison
from experiments.metrics.signed_error import SignedError
from experiments.metrics.vertex_l2 import VertexL2
from retarget.check import InvalidInput
from retarget.types import FloatArray, Regions

REGIONS = Regions(vertices={"head": np.arange(4), "lips": np.array([0, 1])})


def comparison(error: FloatArray) -> Comparison:
    truth = np.random.default_rng(0).normal(size=error.shape)
    blank = np.zeros(error.shape[1:])
    return Comparison(truth + error, truth, truth, blank, blank, np.array([[0, 1, 2]]), REGIONS)


def measured(metric: VertexL2 | SignedError, error: FloatArray) -> dict[tuple[str, str], list[float]]:
    return {(m.metric, m.region): m.values.round(12).tolist() for m in metric(comparison(error))}


def test_vertex_l2_by_hand() -> None:
    error = np.array(
        [[[3, 4, 0], [0, 0, 1], [0, 0, 0], [0, 2, 0]], [[0, 0, 0], [0, 0, 0], [0, 0, 0], [1, 2, 2]]], float
    )
    values = measured(VertexL2(["mean", "max", "p95"], ["head", "lips"]), error)
    assert values["vertex_l2_mean", "head"] == [2.0, 0.75]
    assert values["vertex_l2_max", "head"] == [5.0, 3.0]
    assert values["vertex_l2_mean", "lips"] == [3.0, 0.0]
    assert values["vertex_l2_p95", "head"] == [4.55, 2.55]  # linear interpolation between the two largest


def test_a_worse_prediction_scores_worse() -> None:
    error = np.random.default_rng(1).normal(size=(3, 4, 3))
    metric = VertexL2(["mean", "p95", "max"], ["head"])
    small, large = measured(metric, error), measured(metric, 1.5 * error)
    assert all(np.all(np.array(large[key]) > np.array(small[key])) for key in small)


def test_signed_error_sees_a_constant_offset_fully() -> None:
    noise = np.array([1.0, -1, 1, -1])[:, None] * np.ones((1, 4, 3))
    values = measured(SignedError(["head"]), noise + np.array([0.05, 0, -0.02]))
    assert values == {
        ("signed_error_x", "head"): [0.05],
        ("signed_error_y", "head"): [0.0],
        ("signed_error_z", "head"): [-0.02],
    }


def test_unknown_statistics_and_regions_are_refused() -> None:
    with pytest.raises(InvalidInput, match="'median'"):
        VertexL2(["median"], ["head"])
    with pytest.raises(InvalidInput, match="'chin': this dataset has head, lips"):
        measured(VertexL2(["mean"], ["chin"]), np.zeros((1, 4, 3)))
