from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.geometry.procrustes import similarity_align
from retarget.geometry.triangles import areas
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.simulation.characteristics import EYE_OPENINGS, EYE_SOCKETS, FacialCharacteristics
from retarget.types import Pair
from tests.retarget.simulation.box_head import box_head


@pytest.fixture(scope="module")
def pair():
    source, target = box_head(shape=np.diag([1.2, 0.9, 1.0]) + 0.04), box_head()
    return Pair(target.template.faces, source.skin, target.skin, target.template.regions)


def smiling(pair):
    x, y, z = pair.source_neutral.T
    return pair.source_neutral + np.c_[2 * np.sin(x / 20), 0.05 * x**2 / 10, np.cos(y / 9)] * (z / 20)[:, None]


@pytest.mark.parametrize("form", ["relative", "printed"])
def test_the_neutral(pair, form):
    """The areas of the neutral are the neutral's; its contour is so in the relative form alone."""
    found = FacialCharacteristics(pair, form)(pair.source_neutral)
    np.testing.assert_allclose(found.eye_opening, 1)
    np.testing.assert_allclose(found.eye_socket, 1)
    missed = np.abs(found.lip_contour - pair.target_neutral[pair.regions.loops["lip_contour"]]).max()
    assert (missed < 1e-9) == (form == "relative")
    assert (missed > 0.1) == (form == "printed")


def test_areas_against_their_definition(pair):
    skin = smiling(pair)
    found = FacialCharacteristics(pair)(skin)
    for names, ratios in ((EYE_OPENINGS, found.eye_opening), (EYE_SOCKETS, found.eye_socket)):
        triangles = np.concatenate([pair.regions.patches[name] for name in names])
        np.testing.assert_allclose(ratios, areas(skin, triangles) / areas(pair.source_neutral, triangles))


def test_the_printed_contour_is_a_similar_copy_of_the_source_s_close_to_the_transfer(pair):
    fc, skin = FacialCharacteristics(pair, "printed"), smiling(pair)
    contour = pair.regions.loops["lip_contour"]
    found = fc(skin).lip_contour
    ratio = np.linalg.norm(np.diff(found, axis=0), axis=1) / np.linalg.norm(np.diff(skin[contour], axis=0), axis=1)
    np.testing.assert_allclose(ratio, ratio[0])
    rng = np.random.default_rng(0)
    coarse = DeformationTransfer.of(pair, Weighting.UNIFORM)(skin[None])[0][contour]
    best = ((found - coarse) ** 2).sum()
    for _ in range(100):
        turned = Rotation.from_rotvec(0.05 * rng.normal(size=3)).apply(found) * (1 + 0.02 * rng.normal())
        turned += coarse.mean(axis=0) - turned.mean(axis=0)
        assert ((turned - coarse) ** 2).sum() >= best - 1e-12


def test_itself_as_target_gives_the_expression_s_contour(pair):
    same = replace(pair, target_neutral=pair.source_neutral)
    skin = smiling(same)
    for form in ("printed", "relative"):
        contour = FacialCharacteristics(same, form)(skin).lip_contour
        np.testing.assert_allclose(contour, skin[pair.regions.loops["lip_contour"]], atol=1e-9)


def test_a_triangle_without_an_area_follows_its_patch(pair):
    patch = pair.regions.patches["eye_opening_left"].copy()
    patch[0, 2] = patch[0, 1]
    regions = replace(pair.regions, patches={**pair.regions.patches, "eye_opening_left": patch})
    skin = smiling(pair)
    found = FacialCharacteristics(replace(pair, regions=regions))(skin).eye_opening
    whole = [areas(v, patch).sum() for v in (skin, pair.source_neutral)]
    assert found[0] == pytest.approx(whole[0] / whole[1])
    assert np.isfinite(found).all()


def test_terms_that_the_topology_lacks_are_left_out(pair):
    bare = replace(pair, regions=replace(pair.regions, loops={}, patches={}))
    found = FacialCharacteristics(bare)(pair.source_neutral)
    assert found.lip_contour is found.eye_opening is found.eye_socket is None


def test_what_is_no_expression_is_refused(pair):
    with pytest.raises(InvalidInput, match="expression: expected"):
        FacialCharacteristics(pair)(pair.source_neutral[1:])
    with pytest.raises(ValueError, match="mirrored"):
        FacialCharacteristics(pair, "mirrored")


def test_similarity_alignment():
    rng = np.random.default_rng(0)
    moving = rng.normal(size=(20, 3))
    rotation = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    scale, turned, shift = similarity_align(moving, 2.5 * moving @ rotation.T + [1, 2, 3])
    assert scale == pytest.approx(2.5)
    np.testing.assert_allclose(turned, rotation, atol=1e-12)
    np.testing.assert_allclose(shift, [1, 2, 3], atol=1e-12)
    noisy = 2.5 * moving @ rotation.T + rng.normal(size=(20, 3))
    scale, turned, shift = similarity_align(moving, noisy)
    best = ((scale * moving @ turned.T + shift - noisy) ** 2).sum()
    for factor in (0.99, 1.01):
        assert ((factor * scale * (moving - moving.mean(0)) @ turned.T + noisy.mean(0) - noisy) ** 2).sum() > best
    mirrored = similarity_align(moving, moving * [-1, 1, 1])
    assert np.linalg.det(mirrored[1]) == pytest.approx(1)
    assert mirrored[0] < 1
