from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.simulation.bones import (
    SKIN_SLIDE,
    SLIDE,
    bounding_box_diameter,
    fit_bones,
    pivot,
    place_bones,
    rotation_angle,
    size_ratio,
)
from retarget.simulation.state import Bones, RigidMotion
from retarget.types import Regions
from tests.retarget.simulation.box_head import box_head


def turn(axis, degrees):
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def opened(head, degrees=10.0, slide=(0.0, -1.0, 2.0), nod=0.0):
    """The skin with its jaw part turned about the joints and slid, and everything nodded by a global rotation."""
    jaw = RigidMotion(turn("x", degrees), np.asarray(slide), pivot(head))
    members = head.template.regions.vertices["jaw_skin"]
    skin = head.skin.copy()
    skin[members] = jaw(skin[members])
    return (skin - pivot(head)) @ turn("x", nod).T + pivot(head), jaw


def test_the_fit_finds_the_motions_that_were_applied():
    head = box_head()
    skin, jaw = opened(head)
    bones = fit_bones(head, skin)
    np.testing.assert_allclose(bones.jaw.rotation, jaw.rotation, atol=1e-12)
    np.testing.assert_allclose(bones.jaw.translation, jaw.translation, atol=1e-9)
    np.testing.assert_allclose(bones.cranium.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(bones.cranium.translation, 0, atol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 10.0, 40.0])
@pytest.mark.parametrize("nod", [0.0, 0.8])
def test_a_jaw_at_its_joint_finds_a_hinge_exactly(degrees, nod):
    """A pure hinge costs no prior, whatever the cranium does."""
    head = box_head()
    skin, jaw = opened(head, degrees, slide=(0, 0, 0), nod=nod)
    bones = fit_bones(head, skin, "joint")
    np.testing.assert_allclose(bones.jaw.rotation, turn("x", nod) @ jaw.rotation, atol=1e-9)
    np.testing.assert_allclose(bones.jaw.translation, 0, atol=1e-7)


def test_a_jaw_at_its_joint_ignores_most_of_what_its_skin_does_alone():
    """Skin pulled back at one end turns and shifts a jaw that is fitted freely."""
    head = box_head()
    members = head.template.regions.vertices["jaw_skin"]
    skin = head.skin.copy()
    skin[members[: len(members) // 2]] += [0.5, 2.0, -2.0]
    free, joint = (fit_bones(head, skin, jaw).jaw for jaw in ("free", "joint"))
    assert rotation_angle(joint.rotation) < 0.5 * rotation_angle(free.rotation)
    assert np.linalg.norm(joint.translation) < 0.5 * np.linalg.norm(free.translation)


def test_a_joint_slides_by_the_balance_of_skin_and_prior():
    """All skin of the jaw forward by 4 mm, without a turn to gain: 4 / (1 + SKIN_SLIDE^2 / SLIDE^2) by hand."""
    head = box_head()
    members = head.template.regions.vertices["jaw_skin"]
    centred = replace(head, condyles=head.condyles + (head.skin[members].mean(axis=0) - pivot(head)))
    skin = centred.skin.copy()
    skin[members] += [0, 0, 4.0]
    found = fit_bones(centred, skin, "joint").jaw
    np.testing.assert_allclose(found.translation, [0, 0, 4.0 / (1 + SKIN_SLIDE**2 / SLIDE[2] ** 2)], atol=1e-6)
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-9)


def test_a_hinge_has_no_translation():
    head = box_head()
    bones = fit_bones(head, opened(head, slide=(0, 0, 0))[0])
    np.testing.assert_allclose(bones.jaw.translation, 0, atol=1e-9)
    assert rotation_angle(bones.jaw.rotation) == pytest.approx(10)


def test_bones_of_a_larger_copy_move_as_in_the_larger_picture():
    head, factor = box_head(), 1.7
    large = box_head(shape=factor * np.eye(3))
    bones = fit_bones(head, opened(head)[0])
    scale = size_ratio(head.skin, large.skin)
    assert scale == pytest.approx(factor)
    np.testing.assert_allclose(place_bones(large, bones, scale), factor * place_bones(head, bones), atol=1e-9)


def test_bones_are_placed_in_the_order_of_the_fixed_vertices():
    head = box_head()
    still = RigidMotion(np.eye(3), np.zeros(3), pivot(head))
    placed = place_bones(head, Bones(still, replace(still, translation=np.array([0, 5.0, 0]))))
    lifted = placed - head.vertices[head.template.fixed]
    np.testing.assert_allclose(lifted[np.isin(head.template.fixed, head.template.jaw), 1], 5)
    np.testing.assert_allclose(lifted[np.isin(head.template.fixed, head.template.cranium)], 0)


def test_the_diameter_is_the_diagonal_of_the_box():
    assert bounding_box_diameter(np.array([[0.0, 0, 0], [1, 2, 2], [0.5, 1, 0]])) == 3


def test_a_head_that_moves_is_refused_with_the_motion_found():
    head = box_head()
    with pytest.raises(InvalidInput, match=r"its cranium turns by 2\.00 degrees"):
        fit_bones(head, opened(head, nod=2.0)[0])
    with pytest.raises(InvalidInput, match=r"turns by 0\.00 degrees and moves by 1\.50 mm"):
        fit_bones(head, head.skin + np.array([0, 1.5, 0]))
    fit_bones(head, head.skin + np.array([0, 0.5, 0]))


@pytest.mark.parametrize(("degrees", "slide"), [(60.0, (0, 0, 0)), (0.0, (0, 0, 50.0))])
def test_a_jaw_that_opens_too_far_is_refused(degrees, slide):
    head = box_head()
    with pytest.raises(InvalidInput, match=r"opens as jaws can, but it turns by \d+\.\d degrees"):
        fit_bones(head, opened(head, degrees, slide)[0])


def test_what_a_fit_needs_is_named():
    head = box_head()
    bare = replace(head, template=replace(head.template, regions=Regions()))
    with pytest.raises(InvalidInput, match=r"vertices\['cranium'\], got 0"):
        fit_bones(bare, head.skin)
    with pytest.raises(InvalidInput, match="expression: 1 vertices are NaN"):
        fit_bones(head, np.where(np.arange(len(head.skin))[:, None] == 7, np.nan, head.skin))
