import numpy as np
import pytest

from retarget.check import InvalidInput, UnsupportedProblem
from retarget.geometry.patches import contiguous_patches
from retarget.rig.blendshapes import (
    CHUNK,
    Blendshapes,
    BlendshapeTransfer,
    Residual,
    Ridge,
    RidgeFit,
    blendshapes_of,
    projection,
    whole_mesh,
)
from retarget.types import Examples, Pair
from tests.synthetic import ball, expressions, head

N = 642
layouts = pytest.mark.parametrize("patch_count", [1, 12])


def layout(count):
    return whole_mesh(N) if count == 1 else contiguous_patches(ball()[1], N, count)


def literal_weights(basis, displacement, penalty):
    """Eq. (2) for one patch and frame as a stacked least-squares problem."""
    k = len(basis)
    matrix = np.vstack([basis.reshape(k, -1).T, np.sqrt(penalty) * np.eye(k)])
    return np.linalg.lstsq(matrix, np.r_[displacement.ravel(), np.zeros(k)], rcond=None)[0]


@layouts
@pytest.mark.parametrize(
    ("ridge", "penalty"),
    [
        (Ridge(0.02), lambda n: 0.02 * n),
        (Ridge(0.02, Residual.SUM), lambda n: 0.02),
        (Ridge(0.01, "sum", length_mm=10), lambda n: 1.0),  # 0.01 cm^2 = 1 mm^2
        (Ridge(0.01, length_mm=10), lambda n: n),
    ],
)
def test_equals_least_squares_frame_by_frame(patch_count, ridge, penalty):
    patches = layout(patch_count)
    source, target, s, t = expressions(1, 9), expressions(2, 4), head(1), head(2)
    result = BlendshapeTransfer(s, source[:4], t, target, patches, ridge)(source)
    for i, frame in enumerate(source):
        for patch in patches:
            basis = (source[:4] - s)[:, patch]
            w = literal_weights(basis, (frame - s)[patch], penalty(len(patch)))
            np.testing.assert_allclose(result.source[i, patch], s[patch] + np.tensordot(w, basis, 1), atol=1e-9)
            moved = np.tensordot(w, (target - t)[:, patch], 1)
            np.testing.assert_allclose(result.target[i, patch], t[patch] + moved, atol=1e-9)


@layouts
def test_blended_examples_are_recovered_as_lambda_goes_to_zero(patch_count):
    """The error of a frame inside of the span is proportional to lambda."""
    neutral, examples = head(1), expressions(1, 4)
    frame = neutral + np.tensordot([0.5, -0.2, 0.9, 0.1], examples - neutral, 1)

    def error(lambda_reg):
        fit = projection(neutral, examples, frame[None], layout(patch_count), Ridge(lambda_reg))
        return np.abs(fit - frame).max()

    assert error(1e-9) < 1e-4
    assert error(1e-9) / error(1e-10) == pytest.approx(10, rel=0.05)


def test_lambda_per_vertex_does_not_depend_on_the_resolution():
    """Every vertex twice: the mean residual gives the same weights, the sum does not."""
    neutral, examples, frame = head(1), expressions(1, 3), expressions(1, 5)[4:]
    twice = [np.concatenate([a, a], axis=-2) for a in (neutral, examples, frame)]

    def weights(ridge, neutral, examples, frame):
        patches = whole_mesh(len(neutral))
        return RidgeFit(Blendshapes(neutral, examples, patches), ridge).weights(frame)[0]

    np.testing.assert_allclose(weights(Ridge(1.0), *twice), weights(Ridge(1.0), neutral, examples, frame), rtol=1e-10)
    summed = Ridge(500.0, Residual.SUM)
    assert np.abs(weights(summed, *twice) - weights(summed, neutral, examples, frame)).max() > 1e-3


def test_more_regularisation_makes_smaller_weights():
    blendshapes, frame = Blendshapes(head(1), expressions(1, 4), whole_mesh(N)), expressions(1, 6)[5:]
    norms = [np.linalg.norm(RidgeFit(blendshapes, Ridge(r)).weights(frame)[0]) for r in (1e-4, 1e-1, 1e2, 1e5)]
    assert norms == sorted(norms, reverse=True)
    assert norms[-1] < 1e-3


@layouts
def test_no_examples_rebuild_the_neutral(patch_count):
    frames, none = expressions(1, 3), np.empty((0, N, 3))
    result = BlendshapeTransfer(head(1), none, head(2), none, layout(patch_count), Ridge(0.01))(frames)
    np.testing.assert_array_equal(result.source, np.broadcast_to(head(1), frames.shape))
    np.testing.assert_array_equal(result.target, np.broadcast_to(head(2), frames.shape))


def test_examples_that_repeat_or_do_not_move_a_patch_are_no_problem():
    examples = expressions(1, 2)
    doubled = np.concatenate([examples, examples, head(1)[None]])
    fit = projection(head(1), doubled, examples, layout(12), Ridge(1e-8))
    np.testing.assert_allclose(fit, examples, atol=1e-4)


def test_patches_explain_at_least_as_much_as_the_mesh():
    examples, frames = expressions(1, 5), expressions(1, 12)
    error = [np.mean((projection(head(1), examples, frames, layout(c), Ridge(1e-6)) - frames) ** 2) for c in (12, 1)]
    assert error[0] < error[1]


def test_chunks_do_not_change_the_result():
    frames = expressions(1, 2 * CHUNK + 5)
    transfer = BlendshapeTransfer(head(1), frames[:4], head(2), expressions(2, 4), layout(12), Ridge(0.01))
    together = transfer(frames)
    for i, frame in enumerate(frames):
        alone = transfer(frame[None])
        np.testing.assert_allclose(alone.source[0], together.source[i], atol=1e-10)
        np.testing.assert_allclose(alone.target[0], together.target[i], atol=1e-10)
    assert transfer(frames[:0]).target.shape == (0, N, 3)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lambda_reg": 0.0}, "lambda_reg: expected a positive number, got 0.0"),
        ({"lambda_reg": np.nan}, "lambda_reg"),
        ({"lambda_reg": 1.0, "length_mm": -1.0}, "length_mm"),
        ({"lambda_reg": 1.0, "residual": "median"}, "'median' is unknown, expected one of mean, sum"),
    ],
)
def test_refuses_settings_out_of_range(settings, message):
    with pytest.raises(InvalidInput, match=message):
        Ridge(**settings)


def test_refuses_examples_that_do_not_correspond():
    with pytest.raises(InvalidInput, match="expected one source example for each of the 2 target examples, got 3"):
        BlendshapeTransfer(head(1), expressions(1, 3), head(2), expressions(2, 2), whole_mesh(N), Ridge(1.0))
    pair = Pair(ball()[1], head(1), head(2))
    with pytest.raises(UnsupportedProblem, match="counterparts"):
        blendshapes_of(pair, Examples(expressions(2, 2), None), whole_mesh(N), Ridge(1.0))
