"""The fit of the head template to characters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from retarget.anatomy.closed import cap
from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.distance import distance_to, signed_distance
from retarget.anatomy.fit import DEPTH_RULE, fit_head, fit_with_report
from retarget.anatomy.head import Head, HeadTemplate
from retarget.anatomy.store import load_template
from retarget.check import InvalidInput
from retarget.simulation.tetrahedra import rest_shape
from retarget.types import FloatArray, IntArray
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

TURN = Rotation.from_euler("xyz", [8.0, -20.0, 5.0], degrees=True).as_matrix()
SHIFT = np.array([40.0, -900.0, 15.0])


@pytest.fixture(scope="module")
def template() -> HeadTemplate:
    base, _ = load_head()
    return load_template(base.faces, load_regions(), "coarse")


@pytest.fixture(scope="module")
def sampler() -> IdentitySampler:
    return IdentitySampler(*load_head(), load_regions())


@pytest.fixture(scope="module")
def man(template: HeadTemplate, sampler: IdentitySampler) -> Head:
    return fit_head(template, sampler(0).vertices)


def assert_sound(head: Head) -> None:
    """What the fit promises, measured again by other means."""
    template = head.template
    rest_shape(head.vertices, template.tets)  # refuses inverted and flat tets
    assert np.abs(template.embedding @ head.vertices + head.residual - head.skin).max() < 1e-12
    skin = cap("skin", head.skin, template.faces)
    assert signed_distance(skin, head.vertices[template.skull]).min() > 0
    skull = head.vertices, template.skull_faces
    assert signed_distance(skin, head.vertices[template.skull_faces].mean(axis=1)).min() > 0
    assert len(self_intersections(*skull)) == 0
    marks = head.skin[[template.regions.landmarks[name] for name in head.depth_errors]]
    wanted = np.array([template.depths[name] for name in head.depth_errors])
    errors = distance_to(skull, marks) - wanted
    assert errors == pytest.approx(np.array(list(head.depth_errors.values())), abs=1e-9)
    assert np.abs(errors).max() <= DEPTH_RULE
    assert len(errors) >= len(template.depths) / 2


def test_the_template_fits_itself(template: HeadTemplate) -> None:
    head = fit_head(template, template.skin)
    assert np.abs(head.vertices - template.vertices).max() < 1e-6
    assert_sound(head)


def test_a_moved_character_gives_the_moved_head(template: HeadTemplate, man: Head) -> None:
    moved = fit_head(template, man.skin @ TURN.T + SHIFT)
    assert np.abs(moved.vertices - (man.vertices @ TURN.T + SHIFT)).max() < 0.05  # two paths of the repair's iteration
    assert np.percentile(np.abs(moved.vertices - (man.vertices @ TURN.T + SHIFT)), 99) < 1e-3
    assert np.abs(moved.condyles - (man.condyles @ TURN.T + SHIFT)).max() < 1e-9


def test_a_larger_head_keeps_its_depths_in_mm(template: HeadTemplate) -> None:
    head = fit_head(template, 1.15 * template.skin)
    assert_sound(head)
    names = [n for n in head.depth_errors if n in ("glabella", "nasion", "frontal_eminence_left", "zygion_left")]
    scaled = template.vertices * 1.15, template.skull_faces
    marks = head.skin[[template.regions.landmarks[n] for n in names]]
    assert len(names) == 4
    depths = np.array([template.depths[n] for n in names])
    found, by_scale = distance_to((head.vertices, template.skull_faces), marks), distance_to(scaled, marks)
    assert np.abs(found - depths).mean() < np.abs(by_scale - depths).mean()


@pytest.mark.parametrize("seed", [0, 1])
def test_sampled_identities_are_sound(template: HeadTemplate, sampler: IdentitySampler, seed: int) -> None:
    head, report = fit_with_report(template, sampler(seed).vertices)
    assert_sound(head)
    assert report.skull.clearance > 0.5
    residual = np.linalg.norm(head.residual[template.regions.vertices["head"]], axis=1)
    assert np.percentile(residual, 95) < 0.9  # ears; 0.47 on the skin subdivided once


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 20))
def test_more_identities_are_sound(template: HeadTemplate, sampler: IdentitySampler, seed: int) -> None:
    assert_sound(fit_head(template, sampler(seed).vertices))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.25, 1.5])
def test_exaggerated_identities_are_sound(template: HeadTemplate, sampler: IdentitySampler, factor: float) -> None:
    mean = np.mean([sampler(seed).vertices for seed in range(6)], axis=0)
    for seed in range(2):
        assert_sound(fit_head(template, mean + factor * (sampler(seed).vertices - mean)))


def test_the_same_character_gives_the_same_bits(template: HeadTemplate, man: Head) -> None:
    again = fit_head(template, man.skin)
    assert np.array_equal(again.vertices, man.vertices)
    assert again.depth_errors == man.depth_errors


def test_condyles_lie_inside_the_head_left_and_right(man: Head) -> None:
    assert man.condyles[0, 0] > 0 > man.condyles[1, 0]
    assert signed_distance(cap("skin", man.skin, man.template.faces), man.condyles).min() > 5.0


def broken(skin: FloatArray, faces: IntArray, how: str) -> FloatArray:
    skin = skin.copy()
    if how == "nan":
        skin[7] = np.nan
    elif how == "count":
        skin = skin[:-1]
    elif how == "unit":
        skin *= 0.1
    elif how == "order":
        skin = np.random.default_rng(0).permutation(skin)
    elif how == "mirrored":
        skin = skin * [-1, 1, 1]
    elif how == "axes":
        skin = skin[:, [0, 2, 1]] * [1, 1, -1]
    elif how == "collapsed":
        skin[:] = skin[0]
    elif how == "degenerate":
        skin[faces[0, 0]] = skin[faces[0, 1]]
    elif how == "folded":
        nose = np.linalg.norm(skin - skin[load_regions().landmarks["pronasale"]], axis=1) < 25
        skin[nose, 2] -= 70.0  # the nose is pushed through to the inside of the head
    elif how == "pressed":
        skin[np.argmax(skin[:, 2]), 2] -= 60.0  # the tip of the nose alone
    return skin


@pytest.mark.parametrize(
    ("how", "reason"),
    [
        ("nan", "NaN or infinite"),
        ("count", "expected the 4328 vertices"),
        ("unit", "vertices are in mm"),
        ("order", "another order"),
        ("mirrored", "mirrored"),
        ("axes", r"\+y up"),
        ("collapsed", "vertices are in mm"),
        ("degenerate", "degenerate"),
        ("folded", "crosses itself at lips and lids at most"),
        ("pressed", "crosses itself at lips and lids at most"),
    ],
)
def test_what_cannot_be_fitted_is_refused_with_the_reason(template: HeadTemplate, how: str, reason: str) -> None:
    with pytest.raises(InvalidInput, match=reason):
        fit_head(template, broken(template.skin, template.faces, how))


def test_depths_that_leave_no_room_are_refused(template: HeadTemplate) -> None:
    deep = replace(template, depths=dict.fromkeys(template.depths, 24.0))
    with pytest.raises(InvalidInput, match="room for bone under at least"):
        fit_head(deep, template.skin)
