"""ICT-FaceKit as a dataset. The model is not shipped: what needs it is skipped without a copy beside the checkout."""

from __future__ import annotations

import json
import tarfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from retarget.anatomy.crossings import self_intersections
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.skin import isolate_skin
from retarget.anatomy.store import content_digest, file_name, shipped
from retarget.check import InvalidInput, check_frames
from retarget.geometry.procrustes import rigid_align
from retarget.io.mesh import read_mesh
from retarget.io.regions import check_regions
from synth_data.arkit import SKIN_NAMES
from synth_data.cache import ArrayCache
from synth_data.ict_facekit.author_data import author_regions
from synth_data.ict_facekit.clone import FOLDER, NEUTRAL, SKIN_VERTICES, Clone, find_clone, read_skin
from synth_data.ict_facekit.dataset import IctFaceKit
from synth_data.ict_facekit.expressions import EXPRESSIONS, parts
from synth_data.ict_facekit.identities import LARGEST, IdentitySampler, coefficient
from synth_data.ict_facekit.model import FaceModel, read_model
from synth_data.ict_facekit.regions import load_regions
from synth_data.performed import PerformedDataset
from synth_data.truth import GenericRig, person_key

REPOSITORY = Path(__file__).parents[2]
ARCHIVE = REPOSITORY.parent / "shared/data/ict_facekit/ict_facekit_subset.tar.xz"
LANDMARKS = REPOSITORY / "docs/examples/ict_facekit_landmarks.json"


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not ARCHIVE.is_file():
        pytest.skip("no copy of ICT-FaceKit beside the checkout")
    folder = tmp_path_factory.mktemp("ict")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(folder, filter="data")
    return next(folder.rglob(FOLDER)).parent


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def model(root: Path, cache: Path) -> FaceModel:
    clone = find_clone(root)
    return read_model(clone, clone.digest(), ArrayCache.of(cache))


@pytest.fixture(scope="module")
def data(root: Path, cache: Path, model: FaceModel) -> PerformedDataset:
    return IctFaceKit(root=str(root), identities=2, expressions=6, truth="additive", cache=str(cache)).load()


def linked(root: Path, folder: Path, without: str = "", **changed: bytes) -> Path:
    """A clone that shares its files with another one, but for those that are left out or changed."""
    target = folder / FOLDER
    target.mkdir()
    for path in (root / FOLDER).glob("*.obj"):
        if path.stem in changed:
            (target / path.name).write_bytes(changed[path.stem])
        elif not (without and path.stem.startswith(without)):
            (target / path.name).symlink_to(path)
    return folder


# --- names -------------------------------------------------------------------------------------------------------


def test_every_unit_of_arkit_is_made_of_expressions() -> None:
    assert (parts("browInnerUp"), parts("cheekPuff")) == (
        ("browInnerUp_L", "browInnerUp_R"),
        ("cheekPuff_L", "cheekPuff_R"),
    )
    assert parts("mouthSmileLeft") == ("mouthSmile_L",)
    assert (parts("jawLeft"), parts("mouthRight"), parts("jawOpen")) == (("jawLeft",), ("mouthRight",), ("jawOpen",))
    assert len(EXPRESSIONS) == len(set(EXPRESSIONS)) == 53


def test_the_expressions_are_those_that_the_model_lists(root: Path) -> None:
    listed = json.loads((root / FOLDER / "vertex_indices.json").read_text())["expressions"]
    assert sorted(listed) == list(EXPRESSIONS)


# --- the model ---------------------------------------------------------------------------------------------------


def test_skin_is_the_connected_piece_that_holds_the_face(root: Path, model: FaceModel) -> None:
    vertices, faces = read_mesh(root / FOLDER / f"{NEUTRAL}.obj")
    kept, triangles = isolate_skin(faces, len(vertices), {"nose": 4857})
    np.testing.assert_array_equal(kept, np.arange(SKIN_VERTICES))
    np.testing.assert_array_equal(triangles, model.faces)
    np.testing.assert_allclose(model.neutral, 10 * vertices[kept], atol=1e-5)  # cm to mm


def test_units_are_differences_of_meshes_and_halves_add_up(root: Path, model: FaceModel) -> None:
    def difference(name: str) -> Any:
        return 10 * read_mesh(root / FOLDER / f"{name}.obj")[0][:SKIN_VERTICES] - model.neutral

    for unit, made_of in (("mouthSmileLeft", ["mouthSmile_L"]), ("browInnerUp", ["browInnerUp_L", "browInnerUp_R"])):
        expected = np.sum([difference(name) for name in made_of], axis=0)
        np.testing.assert_allclose(model.units[SKIN_NAMES.index(unit)], expected, atol=3e-5)
    np.testing.assert_allclose(model.modes[3], difference("identity003"), atol=3e-5)


def test_left_is_the_persons_own(model: FaceModel) -> None:
    regions = load_regions()
    smile = np.linalg.norm(model.units[SKIN_NAMES.index("mouthSmileLeft")], axis=1)
    assert smile[regions.landmarks["cheilion_left"]] > 5 > 1 > smile[regions.landmarks["cheilion_right"]]
    assert model.units[SKIN_NAMES.index("jawLeft"), regions.landmarks["menton"], 0] > 5  # mm, +x is left


def test_what_is_cached_is_what_is_read(root: Path, model: FaceModel) -> None:
    clone = find_clone(root)
    few = Clone(clone.neutral, clone.expressions, {3: clone.modes[3]})
    fresh = read_model(few, "", ArrayCache())
    np.testing.assert_array_equal(fresh.units, model.units)
    np.testing.assert_array_equal(fresh.modes[3], model.modes[3])


# --- regions and template ----------------------------------------------------------------------------------------


def test_regions_fit_and_the_mirror_pairs_all_vertices(model: FaceModel) -> None:
    regions = load_regions()
    check_regions("regions.json", regions, SKIN_VERTICES, model.faces)
    assert regions.mirror is not None
    mirrored = model.neutral[regions.mirror] * [-1, 1, 1]
    assert np.linalg.norm(mirrored - model.neutral, axis=1).max() < 0.1  # mm


def test_what_ships_was_made_from_the_generic_skin(root: Path) -> None:
    skin, faces, regions = author_regions(root / FOLDER / f"{NEUTRAL}.obj", LANDMARKS)
    again = "run python -m synth_data.ict_facekit.author_data"
    ours = load_regions()
    for name, members in regions.vertices.items():
        np.testing.assert_array_equal(members, ours.vertices[name], err_msg=again)
    for name, loop in regions.loops.items():
        np.testing.assert_array_equal(loop, ours.loops[name], err_msg=again)
    assert dict(regions.landmarks) == dict(ours.landmarks), again
    stored = shipped(file_name(faces))
    assert stored is not None, again
    np.testing.assert_allclose(stored.skin, skin, atol=1e-5)
    depths = depths_with_room(stored.skin, faces, ours, landmark_depths(load_depths(), ours))
    assert stored.content == content_digest(stored.skin, faces, ours, depths), again


def test_nostrils_are_inside_alike_on_both_sides() -> None:
    regions = load_regions()
    assert regions.mirror is not None
    inside, marks = regions.vertices["interior"], regions.landmarks
    assert not np.isin(inside, regions.vertices["head"]).any()
    assert not np.isin(inside, [marks[name] for name in ("alare_left", "alare_right", "subnasale", "pronasale")]).any()
    mirrored = np.sort(regions.mirror[regions.vertices["nose"]])
    assert len(np.setxor1d(mirrored, regions.vertices["nose"])) < 0.1 * len(mirrored)  # the transfer is not symmetric
    assert len(np.intersect1d(mirrored, inside)) == 0


def test_what_is_kept_of_a_person_belongs_to_the_regions(model: FaceModel) -> None:
    regions = load_regions()
    person = IdentitySampler(model, regions)(0)
    others = replace(regions, vertices={**regions.vertices, "interior": regions.vertices["interior"][1:]})
    keys = {person_key("a", GenericRig(model.neutral, model.faces, model.units, r), person) for r in (regions, others)}
    assert len(keys) == 2


# --- people ------------------------------------------------------------------------------------------------------


def test_coefficients_are_a_gaussian_cut_at_a_bound() -> None:
    drawn = np.array([coefficient(seed, mode) for seed in range(1000, 1060) for mode in range(60)])
    assert np.abs(drawn).max() <= LARGEST
    assert abs(drawn.mean()) < 4 / np.sqrt(len(drawn))
    # the variance of a standard Gaussian cut at 2: 1 - 4 pdf(2) / (cdf(2) - cdf(-2))
    assert drawn.var() == pytest.approx(1 - 4 * 0.053991 / 0.954500, rel=0.06)


def test_a_head_is_the_sum_of_its_modes_at_true_size_on_the_generic_cranium(model: FaceModel) -> None:
    regions = load_regions()
    sample = IdentitySampler(model, regions)
    head = sample(7).neutral
    expected = model.neutral + sum(coefficient(7, k) * mode for k, mode in model.modes.items())
    away = np.setdiff1d(regions.vertices["cranium_skin"], regions.vertices["lips"])
    rotation, translation = rigid_align(head[away], expected[away])
    np.testing.assert_allclose(head[away] @ rotation.T + translation, expected[away], atol=1e-6)
    cranium = regions.vertices["cranium"]
    rotation, translation = rigid_align(head[cranium], model.neutral[cranium])
    assert np.abs(rotation - np.eye(3)).max() < 1e-9
    assert np.abs(translation).max() < 1e-6
    np.testing.assert_array_equal(sample(7).neutral, head)


def test_lips_are_apart_where_those_of_the_model_cross(model: FaceModel) -> None:
    regions = load_regions()
    sample = IdentitySampler(model, regions)
    assert len(self_intersections(model.neutral, model.faces)) > 50
    for head in (sample.neutral, *(sample(seed).neutral for seed in (0, 2, 6))):
        assert len(self_intersections(head, model.faces)) == 0
    assert np.linalg.norm(sample.neutral - model.neutral, axis=1).max() < 0.5  # mm


# --- the dataset -------------------------------------------------------------------------------------------------


def test_what_a_study_reads(data: PerformedDataset, model: FaceModel) -> None:
    assert (data.conditions.dataset, data.conditions.truth) == ("ict_facekit", "additive")
    assert data.identities == ("person-000", "person-001")
    a, b = (check_frames(name, data.frames(name, range(6)), SKIN_VERTICES) for name in data.identities)
    expected = np.tensordot(data.weights, model.units, axes=1)
    np.testing.assert_allclose(a - data.neutral("person-000"), expected, atol=1e-9)
    np.testing.assert_allclose(b - data.neutral("person-001"), expected, atol=1e-9)
    assert np.linalg.norm(data.neutral("person-000") - data.neutral("person-001"), axis=1).max() > 5  # mm


def test_personal_kinds_of_truth_move_every_unit_and_keep_the_neutral(root: Path, cache: Path) -> None:
    config = IctFaceKit(root=str(root), identities=1, expressions=2, cache=str(cache))
    for truth in ("personal_blendshapes", "nonlinear"):
        played = replace(config, truth=truth).load()
        person = played.identities[0]
        rest, smile = played.perform(person, np.eye(51)[[SKIN_NAMES.index("mouthSmileLeft")]] * [[0.0], [1.0]])
        np.testing.assert_array_equal(rest, played.neutral(person))
        moved = np.linalg.norm(smile - rest, axis=1)
        marks = played.regions.landmarks
        assert moved[marks["cheilion_left"]] > 6 > 1 > moved[marks["cheilion_right"]]  # mm


def test_fingerprint_follows_contents_and_not_places(root: Path, tmp_path: Path) -> None:
    original = (root / FOLDER / "identity003.obj").read_bytes()
    prints = {}
    for name, text in (("same", original), ("changed", original.replace(b"v -2.", b"v -2.0", 1))):
        (tmp_path / name).mkdir()
        prints[name] = IctFaceKit(root=str(linked(root, tmp_path / name, identity003=text)))._fingerprint()
    here = IctFaceKit(root=str(root))
    assert prints["same"] == here._fingerprint() == replace(here, identities=9, cache="/elsewhere")._fingerprint()
    assert prints["changed"] != prints["same"]
    assert replace(here, truth="additive")._fingerprint() != prints["same"]


# --- bad input ---------------------------------------------------------------------------------------------------


def made_up(folder: Path, *without: str, identities: int = 1, text: str = "v 0 0 0\n") -> Path:
    """A clone of files that hold no face."""
    (folder / FOLDER).mkdir()
    for name in (NEUTRAL, *EXPRESSIONS, *(f"identity{i:03d}" for i in range(identities))):
        if name not in without:
            (folder / FOLDER / f"{name}.obj").write_text(text)
    return folder


def test_a_root_that_is_no_clone_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"dataset.root: expected a clone of ICT-FaceKit, got none. git clone"):
        IctFaceKit().load()
    with pytest.raises(InvalidInput, match="/no/such/folder does not exist"):
        IctFaceKit(root="/no/such/folder").load()
    with pytest.raises(InvalidInput, match=r"FaceXModel: expected this folder of the clone, found none"):
        IctFaceKit(root=str(tmp_path)).load()


def test_missing_files_are_named(tmp_path: Path) -> None:
    made_up(tmp_path, NEUTRAL, "jawOpen", "cheekPuff_R")
    with pytest.raises(InvalidInput, match=r"3 of these files are missing: generic_neutral_mesh.obj, cheekPuff_R.obj"):
        find_clone(tmp_path)


def test_a_clone_without_identities_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="expected at least one identity mode"):
        find_clone(made_up(tmp_path, identities=0))


def test_whichever_identity_files_are_there_are_used(tmp_path: Path) -> None:
    clone = find_clone(made_up(tmp_path, "identity001", identities=3) / FOLDER)  # the folder itself will do
    assert tuple(clone.modes) == (0, 2)


def test_pointers_of_git_lfs_are_told_from_meshes(tmp_path: Path) -> None:
    made_up(tmp_path, text="version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n")
    with pytest.raises(InvalidInput, match=r"generic_neutral_mesh.obj: expected a mesh, got a pointer of Git LFS"):
        IctFaceKit(root=str(tmp_path)).load()


def test_other_meshes_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "jawOpen.obj"
    path.write_text("v 0 0 0\n" * 5)
    with pytest.raises(InvalidInput, match=r"jawOpen.obj: expected 26719 vertices, got 5"):
        read_skin(path)
    path.write_text("v 0 0 0\n" * 26_718 + "v 0 0\n")  # eyes and teeth are not read
    assert read_skin(path).shape == (SKIN_VERTICES, 3)
    for bad in ("v 0 0", "v 0 0 x", "v 0 0 nan"):
        path.write_text(f"{bad}\n" + "v 0 0 0\n" * 26_718)
        with pytest.raises(InvalidInput, match=r"jawOpen.obj: "):
            read_skin(path)


def test_settings_are_checked_as_those_of_every_such_dataset() -> None:
    with pytest.raises(InvalidInput, match=r"dataset.identities: expected a whole number of at least 1, got 0"):
        IctFaceKit(identities=0).load()
    with pytest.raises(InvalidInput, match=r"dataset.truth: 'addative' is unknown"):
        IctFaceKit(truth="addative").load()
