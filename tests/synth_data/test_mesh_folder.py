"""A folder of meshes as a user has it: read once, placed, and refused with the file and the mend where it is broken."""

from __future__ import annotations

import dataclasses
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from retarget.check import InvalidInput
from retarget.io.mesh import read_mesh, write_obj
from retarget.io.regions import write_regions
from retarget.types import FloatArray, Regions
from synth_data.dataset import Dataset
from synth_data.mesh_folder.dataset import MeshFolder

BALL = trimesh.creation.icosphere(subdivisions=2)
FACES = np.asarray(BALL.faces, dtype=np.int64)
PEOPLE = {"anna": np.array([72.0, 118, 90]), "bob": np.array([80.0, 125, 97])}  # mm, half axes of a head
EXPRESSIONS = ("frown", "jaw_open", "smile")
CRANIUM = np.flatnonzero(np.asarray(BALL.vertices)[:, 1] > 0.5)


def head(person: str) -> FloatArray:
    """(162, 3) mm with a nose at +z and a bump on the left, so that no rotation maps it to itself."""
    v = np.asarray(BALL.vertices)
    shape = v * PEOPLE[person]
    shape[:, 2] += 20 * np.exp(-8 * ((v - [0, -0.2, 1]) ** 2).sum(axis=1))
    shape[:, 0] += 15 * np.exp(-8 * ((v - [1, 0.5, 0]) ** 2).sum(axis=1))
    return shape


def performed(person: str, expression: str) -> FloatArray:
    """(162, 3) mm: below the cranium something moves, by the same formula for all and with a gain of one's own."""
    v, k = np.asarray(BALL.vertices), EXPRESSIONS.index(expression)
    bump = np.maximum(0.3 - v[:, 1:2], 0) * np.exp(-4 * (v[:, :1] - 0.3 * k) ** 2)
    return head(person) + (8 + len(person)) * bump * np.roll([1.0, -2, 0.5], k)


def moved(vertices: FloatArray, degrees: float, shift: float) -> FloatArray:
    """Turned about the cranium's centre, which is shifted."""
    centre = vertices[CRANIUM].mean(axis=0)
    turn = Rotation.from_rotvec(np.radians(degrees) * np.array([0.6, 0, 0.8])).as_matrix()
    return (vertices - centre) @ turn.T + centre + shift * np.array([0, 0.6, 0.8])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """`scans` of two people with three expressions, and `regions.json`."""
    root = tmp_path / "scans"
    for person in PEOPLE:
        write_obj(root / person / "neutral.obj", head(person), FACES)
        for expression in EXPRESSIONS:
            write_obj(root / person / f"{expression}.obj", performed(person, expression), FACES)
    write_regions(root / "regions.json", Regions({"head": np.arange(162), "cranium": CRANIUM}))
    return root


def settings(root: Path, /, **changed: Any) -> MeshFolder:
    start = MeshFolder(root=str(root), regions=str(root), cache=str(root.parent / "cache"))
    return dataclasses.replace(start, **changed)


def everything(data: Dataset) -> FloatArray:
    """(2, 4, n, 3) mm: neutral and expressions of both."""
    count = range(len(data.expressions))
    return np.array([[data.neutral(name), *data.frames(name, count)] for name in data.identities])


TRUTH = np.array([[head(person), *(performed(person, name) for name in EXPRESSIONS)] for person in PEOPLE])
ROUNDING = 2e-5  # mm, of float32 in the store and six digits in the files


def relative(frames: FloatArray) -> FloatArray:
    """Displacements against the neutral: what does not depend on where a person's head is placed."""
    return frames[:, 1:] - frames[:, :1]


def test_what_a_study_reads(folder: Path) -> None:
    data = settings(folder, align="refuse").load()
    assert (data.identities, data.expressions) == (("anna", "bob"), EXPRESSIONS)
    assert (data.conditions.dataset, data.conditions.truth) == ("mesh_folder:scans", "scans")
    np.testing.assert_array_equal(data.faces, FACES)
    np.testing.assert_allclose(everything(data), TRUTH, atol=ROUNDING)
    np.testing.assert_array_equal(data.frames("bob", [2, 0]), data.frames("bob", [0, 1, 2])[[2, 0]])
    assert data.frames("bob", []).shape == (0, 162, 3)
    with pytest.raises(InvalidInput, match="from 0 to 2, got 3"):
        data.frames("bob", [3])
    with pytest.raises(InvalidInput, match="expected one of anna, bob"):
        data.neutral("carl")


def test_the_second_load_reads_no_mesh_and_gives_the_same_bits(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = settings(folder).load()
    monkeypatch.setattr("synth_data.mesh_folder.topology.Topology.read", None)
    again = settings(folder).load()
    assert again.fingerprint == first.fingerprint
    np.testing.assert_array_equal(everything(again), everything(first))


def test_a_damaged_store_is_made_again(folder: Path) -> None:
    before = everything(settings(folder).load())
    for path in (folder.parent / "cache" / "meshes").glob("*.npy"):
        path.write_bytes(path.read_bytes()[:-500])
    np.testing.assert_array_equal(everything(settings(folder).load()), before)


def test_a_changed_mesh_is_read_again_and_changes_the_fingerprint(folder: Path) -> None:
    before = settings(folder).load()
    write_obj(folder / "bob" / "smile.obj", performed("bob", "smile") + 0.25, FACES)
    after = settings(folder, align="refuse").load()
    np.testing.assert_allclose(after.frames("bob", [2])[0], performed("bob", "smile") + 0.25, atol=ROUNDING)
    assert settings(folder).load().fingerprint != before.fingerprint


def test_the_fingerprint_is_of_contents_and_settings_alone(folder: Path) -> None:
    before = settings(folder).load().fingerprint
    copied = folder.parent / "elsewhere" / "scans"
    shutil.copytree(folder, copied)  # new times, another path
    assert settings(copied).load().fingerprint == before
    assert settings(folder, align="refuse").load().fingerprint != before
    write_regions(folder / "regions.json", Regions({"head": np.arange(100), "cranium": CRANIUM}))
    assert settings(folder).load().fingerprint != before


def test_formats_mix_and_give_the_same_meshes(folder: Path) -> None:
    for name in ("smile", "frown"):
        vertices, _ = read_mesh(folder / "bob" / f"{name}.obj")
        (folder / "bob" / f"{name}.obj").unlink()
        if name == "smile":
            np.savez(folder / "bob" / f"{name}.npz", vertices=vertices)  # faces are those of the first mesh
        else:
            trimesh.Trimesh(vertices, FACES, process=False).export(folder / "bob" / f"{name}.PLY", file_type="ply")
    np.testing.assert_allclose(everything(settings(folder, align="refuse").load()), TRUTH, atol=ROUNDING)


def test_faces_may_come_in_another_order(folder: Path) -> None:
    shuffled = np.roll(FACES, 1, axis=1)[::-1]
    write_obj(folder / "bob" / "smile.obj", performed("bob", "smile"), shuffled)
    np.testing.assert_array_equal(settings(folder).load().faces, FACES)


def test_polygons_are_cut_as_in_the_first_mesh(tmp_path: Path) -> None:
    """A cube of quads, warped so that another cut would be another surface."""
    corners = 100.0 * np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    lines = "".join(f"f {' '.join(str(corner + 1) for corner in quad)}\n" for quad in quads)
    for person in ("a", "b"):
        (tmp_path / person).mkdir()
        for name in ("neutral", "smile"):
            text = "".join(f"v {x} {y} {z}\n" for x, y, z in corners + 3 * (name == "smile")) + lines
            (tmp_path / person / f"{name}.obj").write_text(text)
    data = settings(tmp_path, regions=None, align="none").load()
    assert data.faces[:2].tolist() == [[0, 1, 3], [0, 3, 2]]
    assert data.regions.vertices["head"].tolist() == list(range(8))


@pytest.mark.parametrize(
    ("units", "scale"),
    [("mm", 1.0), ("cm", 0.1), ("dm", 0.01), ("m", 0.001), ("inch", 1 / 25.4)],
)
def test_units_and_axes_of_the_files(folder: Path, units: str, scale: float) -> None:
    """Files with +z up that look along -x: the person's left, up x front, is at -y."""
    for path in folder.rglob("*.obj"):
        vertices, faces = read_mesh(path)
        write_obj(path, scale * np.stack([-vertices[:, 2], -vertices[:, 0], vertices[:, 1]], axis=1), faces)
    data = settings(folder, units=units, up="+z", front="-x", align="refuse").load()
    np.testing.assert_allclose(everything(data), TRUTH, atol=1e-3)  # files in m have micrometres


def test_heads_that_move_are_brought_to_rest_and_what_was_removed_is_told(folder: Path) -> None:
    write_obj(folder / "bob" / "smile.obj", moved(performed("bob", "smile"), 4.0, 7.0), FACES)
    lines: list[str] = []
    data = settings(folder).load(lines.append)
    np.testing.assert_allclose(relative(everything(data)), relative(turned_onto_anna(TRUTH)), atol=1e-3)
    (row,) = [line for line in lines if line.startswith("bob ")]
    assert "0.00, 4.00" in row
    assert "0.00, 7.00" in row
    assert row.split()[-2] == "smile"
    assert "up to 4.0 degrees and 7.0 mm" in data.favours


def test_heads_that_are_still_enough_are_left_where_they_are(folder: Path) -> None:
    smile = moved(performed("bob", "smile"), 0.9, 0.9)
    write_obj(folder / "bob" / "smile.obj", smile, FACES)
    data = settings(folder, align="refuse").load()
    np.testing.assert_allclose(data.frames("bob", [2])[0], smile, atol=ROUNDING)
    assert "No mesh was moved; no cranium turns by more than 1 degree or shifts by more than 1 mm" in data.favours


def turned_onto_anna(frames: FloatArray) -> FloatArray:
    """What alignment of the neutrals does, by scipy's second implementation of it."""
    anna, bob = (one[0, CRANIUM] - one[0, CRANIUM].mean(axis=0) for one in frames)
    turn, _ = Rotation.align_vectors(anna, bob)
    return np.array([frames[0], frames[1] @ turn.as_matrix().T])


def test_neutrals_are_aligned_rigidly_and_keep_their_size(folder: Path) -> None:
    for path in (folder / "bob").glob("*.obj"):
        vertices, faces = read_mesh(path)
        write_obj(path, moved(vertices, 30.0, 250.0), faces)
    anna, bob = (neutral[0] for neutral in everything(settings(folder).load()))
    np.testing.assert_allclose(anna, head("anna"), atol=ROUNDING)
    np.testing.assert_allclose(bob[CRANIUM].mean(axis=0), anna[CRANIUM].mean(axis=0), atol=1e-9)
    np.testing.assert_allclose(
        np.linalg.norm(bob[1:] - bob[:-1], axis=1), np.linalg.norm(np.diff(head("bob"), axis=0), axis=1), atol=1e-4
    )
    np.testing.assert_allclose(bob - bob.mean(axis=0), (t := turned_onto_anna(TRUTH)[1, 0]) - t.mean(axis=0), atol=1e-3)


def test_expressions_that_somebody_lacks_are_left_out_by_name(folder: Path) -> None:
    (folder / "bob" / "frown.obj").unlink()
    lines: list[str] = []
    data = settings(folder).load(lines.append)
    assert data.expressions == ("jaw_open", "smile")
    assert "left out, because bob has no mesh of it: frown" in lines
    assert "1 expressions were left out, because not everybody has a mesh of them: frown" in data.favours


def test_hidden_files_and_other_files_are_passed_over(folder: Path) -> None:
    for name in (".smile.obj", "._frown.obj", ".DS_Store", "smile.mtl", "smile.png"):
        (folder / "bob" / name).write_text("no mesh")
    (folder / ".git").mkdir()
    (folder / "textures").mkdir()
    lines: list[str] = []
    assert settings(folder).load(lines.append).expressions == EXPRESSIONS
    assert "passed over: the folder textures holds no mesh" in lines


@pytest.mark.parametrize("name", ["1_Neutral", "alex-rest", "relaxed"])
def test_the_neutral_is_found_by_its_name(folder: Path, name: str) -> None:
    for person in PEOPLE:
        (folder / person / "neutral.obj").rename(folder / person / f"{name}.obj")
    np.testing.assert_allclose(settings(folder, align="refuse").load().neutral("bob"), head("bob"), atol=ROUNDING)


def test_the_neutral_may_be_named_by_a_number(folder: Path) -> None:
    for person in PEOPLE:
        (folder / person / "neutral.obj").rename(folder / person / "5.obj")
    data = settings(folder, neutral=5, align="refuse").load()
    np.testing.assert_allclose(data.neutral("bob"), head("bob"), atol=ROUNDING)


@pytest.mark.parametrize("link", ["bob2", "aaa"])
def test_a_link_to_a_person_is_no_other_person(folder: Path, link: str) -> None:
    (folder / link).symlink_to("bob")
    lines: list[str] = []
    assert settings(folder).load(lines.append).identities == ("anna", "bob")
    assert f"passed over: the folder {link} is the same folder as bob" in lines
    assert settings(folder, identities=2).load().identities == ("anna", "bob")
    assert settings(folder, identities=["anna", link]).load().identities == ("anna", link)
    with pytest.raises(InvalidInput, match=rf"expected each person once, got {link} is bob; remove one"):
        settings(folder, identities=["bob", link]).load()


def test_people_can_be_chosen(folder: Path) -> None:
    shutil.copytree(folder / "anna", folder / "zoe")
    assert settings(folder).load().identities == ("anna", "bob", "zoe")
    assert settings(folder, identities=2).load().identities == ("anna", "bob")
    assert settings(folder, identities=["zoe", "bob"]).load().identities == ("zoe", "bob")


def test_eyeballs_are_left_out_where_landmarks_say_which_piece_is_the_skin(folder: Path) -> None:
    for path in folder.rglob("*.obj"):
        vertices, _ = read_mesh(path)
        both = np.concatenate([FACES, FACES + 162])
        write_obj(path, np.concatenate([0.1 * vertices, vertices]), both)
    (folder / "marks.json").write_text('{"landmarks": {"pronasale": 200}}')
    broken = folder / "other.json"
    write_regions(broken, Regions({"cranium": np.array([500])}))
    with pytest.raises(InvalidInput, match="consist of 2 pieces"):
        settings(folder, regions=str(broken)).load()
    data = settings(folder, landmarks=str(folder / "marks.json"), align="refuse").load()
    np.testing.assert_array_equal(data.faces, FACES)
    np.testing.assert_allclose(everything(data), TRUTH, atol=1e-4)


def test_noise_reaches_what_is_scanned_and_never_the_truth(folder: Path) -> None:
    clean, noisy = settings(folder).load(), settings(folder, noise_mm=0.3).load()
    np.testing.assert_array_equal(everything(noisy), everything(clean))
    added = noisy.scanned("bob", [1]) - clean.frames("bob", [1])
    assert np.sqrt((added**2).sum(axis=2).mean()) == pytest.approx(0.3, rel=0.05)
    assert noisy.fingerprint != clean.fingerprint


def test_without_regions_nothing_is_aligned_unless_the_user_says_so(folder: Path) -> None:
    with pytest.raises(InvalidInput, match=r"topology transfer.*dataset\.align=none"):
        settings(folder, regions=None).load()
    data = settings(folder, regions=None, align="none").load()
    np.testing.assert_allclose(everything(data), TRUTH, atol=ROUNDING)
    assert list(data.regions.vertices) == ["head"]
    assert "nothing was checked for head motion" in data.favours


Spoil = Callable[[Path], object]


def write(name: str, data: bytes | str) -> Spoil:
    return lambda root: (root / name).write_bytes(data.encode() if isinstance(data, str) else data)


def shorten(name: str, share: float) -> Spoil:
    def cut(root: Path) -> None:
        data = (root / name).read_bytes()
        (root / name).write_bytes(data[: int(share * len(data))])

    return cut


def replace(name: str, change: Callable[[FloatArray], FloatArray]) -> Spoil:
    return lambda root: write_obj(root / name, change(read_mesh(root / name)[0]), FACES)


def everyone(change: Callable[[FloatArray], FloatArray], pattern: str = "*.obj") -> Spoil:
    return lambda root: [replace(str(path.relative_to(root)), change)(root) for path in sorted(root.rglob(pattern))]


def as_ply(share: float, encoding: str) -> Spoil:
    def spoil(root: Path) -> None:
        path = root / "bob" / "smile.obj"
        mesh = trimesh.Trimesh(*read_mesh(path), process=False)
        path.unlink()
        mesh.export(path.with_suffix(".ply"), encoding=encoding)
        shorten("bob/smile.ply", share)(root)

    return spoil


def as_npz(**arrays: Any) -> Spoil:
    def spoil(root: Path) -> None:
        (root / "bob" / "smile.obj").unlink()
        np.savez(root / "bob" / "smile.npz", **arrays)

    return spoil


def nan(vertices: FloatArray) -> FloatArray:
    vertices[7, 1] = np.nan
    return vertices


def shuffled(vertices: FloatArray) -> FloatArray:
    return np.random.default_rng(0).permutation(vertices)


def bob_as_npz(change: Callable[[FloatArray], FloatArray], pattern: str) -> Spoil:
    """Without faces, so that nothing but positions tells what was done."""

    def spoil(root: Path) -> None:
        for path in sorted((root / "bob").glob(f"{pattern}.obj")):
            np.savez(path.with_suffix(".npz"), vertices=change(read_mesh(path)[0]))
            path.unlink()

    return spoil


def dented(vertices: FloatArray) -> FloatArray:
    vertices[CRANIUM[::2]] *= 1.3
    return vertices


def rename(before: str, after: str) -> Spoil:
    return lambda root: (root / before).rename(root / after)


OTHER = trimesh.creation.icosphere(subdivisions=1)
MISTAKES: dict[str, tuple[Spoil, dict[str, Any], str]] = {
    "no root": (lambda root: None, {"root": None}, r"set dataset\.root=/path"),
    "no such folder": (lambda root: None, {"root": "/nowhere/at/all"}, r"found none at /nowhere.* check the path"),
    "empty": (lambda root: [shutil.rmtree(root / name) for name in PEOPLE], {}, "got none"),
    "loose": (lambda root: [shutil.rmtree(root / "bob"), shutil.move(root / "anna" / "smile.obj", root)],
              {}, "got anna, and 1 meshes that lie in no person's folder"),
    "one person": (lambda root: shutil.rmtree(root / "bob"), {}, "at least two people .* got anna"),
    "one person and a link": (lambda root: [shutil.rmtree(root / "bob"), (root / "bob").symlink_to("anna")],
                              {}, "got anna, and bob is the same folder as anna"),
    "nothing shared": (lambda root: [rename(f"bob/{name}.obj", f"bob/x{name}.obj")(root) for name in EXPRESSIONS],
                       {}, "no expression has a mesh for each of anna, bob"),
    "twice": (lambda root: as_twice(root), {}, "smile.obj and smile.ply are the same expression twice"),
    "capitals": (rename("bob/smile.obj", "bob/Smile.obj"), {}, r"'smile' \(anna\) and 'Smile' \(bob\) differ only"),
    "no neutral": (lambda root: (root / "bob" / "neutral.obj").unlink(), {},
                   r"no neutral 'neutral' in /.*scans.bob, expected"),
    "no such neutral": (lambda root: (root / "bob" / "smile.obj").unlink(), {"neutral": "smile"},
                        r"no neutral 'smile' in /.*scans.bob, expected"),
    "unnamed neutral": (lambda root: [rename(f"{who}/neutral.obj", f"{who}/a.obj")(root) for who in PEOPLE],
                        {}, r"dataset\.neutral=NAME\. There are a, frown"),
    "two neutrals": (lambda root: [rename(f"{who}/smile.obj", f"{who}/neutral_2.obj")(root) for who in PEOPLE],
                     {}, "neutral, neutral_2 may all be the face at rest"),
    "misspelt neutral": (lambda root: None, {"neutral": "neutrl"}, "Did you mean 'neutral'"),
    "misspelt person": (lambda root: None, {"identities": ["anna", "bop"]}, "Did you mean 'bob'"),
    "too many people": (lambda root: None, {"identities": 5}, "5 asked for, but the folder holds 2"),
    **{f"{setting} is {value!r}": (lambda root: None, {setting: value}, rf"^dataset\.{setting}: expected {expected}$")
       for setting, value, expected in (
           ("root", 5, r"a path \(\./5 for one that is named 5\), got 5\."),
           ("regions", 5, r"a path .*, got 5\."),
           ("cache", ["a"], r"a path .*, got \['a'\]\."),
           ("units", None, r"text such as 'mm', got null\."),
           ("align", None, r"text such as 'load', got null\."),
           ("up", 5, r"text such as '\+y', got 5\."))},
    "neutral is a number": (lambda root: None, {"neutral": 5}, r"dataset\.neutral: '5' is unknown"),
    "one person twice": (lambda root: None, {"identities": ["anna", "anna"]},
                         r"dataset\.identities: expected each person once, got anna, anna; remove one"),
    "a pipe": (lambda root: os.mkfifo(root / "bob" / "e3.obj"), {}, r"bob.e3\.obj: .* found a pipe"),
    "unknown unit": (lambda root: None, {"units": "km"}, r"dataset\.units: 'km' is unknown"),
    "unknown axis": (lambda root: None, {"up": "+w"}, r"dataset\.up: expected one of \+x"),
    "axes that agree": (lambda root: None, {"front": "-y"}, r"expected an axis across dataset\.up"),
    "unknown align": (lambda root: None, {"align": "lod"}, r"Did you mean 'load'"),
    "too few vertices": (lambda root: write_obj(root / "bob" / "smile.obj", 90 * OTHER.vertices, OTHER.faces),
                         {}, r"smile\.obj: 42 vertices, expected 162 as in .*neutral\.obj"),
    "other faces": (lambda root: write_obj(root / "bob" / "smile.obj", head("bob"), FACES[:, ::-1]),
                    {}, r"smile\.obj: as many triangles, but of other vertices"),
    "truncated in a face": (shorten("bob/smile.obj", 0.8), {}, r"bob.smile\.obj: .*triangles, expected 320"),
    "truncated in a vertex": (shorten("bob/smile.obj", 0.3), {}, r"bob.smile\.obj"),
    "truncated after vertices": (lambda root: write(
        "bob/smile.obj", (root / "bob" / "smile.obj").read_text().split("f ")[0])(root),
        {}, r"bob.smile\.obj: expected at least one triangle"),
    "truncated first mesh": (shorten("anna/neutral.obj", 0.8), {}, r"expected .* as in .*anna.neutral\.obj"),
    "truncated ply": (as_ply(0.5, "binary_little_endian"), {}, r"bob.smile\.ply"),
    "truncated ascii ply": (as_ply(0.5, "ascii"), {}, r"bob.smile\.ply"),
    "truncated ascii ply, faces": (as_ply(0.95, "ascii"), {}, r"bob.smile\.ply"),
    "empty file": (write("bob/smile.obj", ""), {}, r"bob.smile\.obj: 0 vertices"),
    "no text": (write("bob/smile.obj", bytes(range(256)) * 9), {}, r"bob.smile\.obj: 0 vertices"),
    "no number": (write("bob/smile.obj", "v 1 2 x\nf 1 2 3\n"), {}, r"bob.smile\.obj: line 1 cannot be read"),
    "unreadable": (lambda root: [(root / "bob" / "smile.obj").unlink(),
                                 (root / "bob" / "smile.obj").symlink_to(root / "gone.obj")],
                   {}, r"bob.smile\.obj: cannot be read .*restore or remove"),
    "nan": (replace("bob/smile.obj", nan), {}, r"bob.smile\.obj: 1 vertices are NaN or infinite, the first at .*7"),
    "pickled": (as_npz(vertices=np.array([{}], dtype=object)), {}, r"bob.smile\.npz: .* never opened"),
    "npz without vertices": (as_npz(points=np.zeros((3, 3))), {}, r"array 'vertices' .* got points"),
    **{f"npz of {dtype}": (lambda root, dtype=dtype: as_npz(vertices=head("bob").astype(dtype))(root), {},
                           rf"bob.smile\.npz: expected real numbers .* got an array of dtype {found}")
       for dtype, found in (("complex128", "complex128"), ("U", "<U32"), ("bool", "bool"))},
    "npz that is none": (lambda root: [as_npz(vertices=head("bob"))(root), shorten("bob/smile.npz", 0.5)(root)],
                         {}, r"bob.smile\.npz: .* cannot be read"),
    "first mesh without faces": (lambda root: [
        (root / "anna" / "neutral.obj").unlink(), np.savez(root / "anna" / "neutral.npz", vertices=head("anna"))],
        {}, r"anna.neutral\.npz: expected the array 'faces'"),
    "metres": (everyone(lambda v: v / 1000), {}, r"measures 0\.236 mm .* Set dataset\.units=m\."),
    "a hundred times too large": (everyone(lambda v: v * 100), {}, r"neutral\.obj: this head measures 2\.36e\+04 mm"),
    "a hundred times too small": (everyone(lambda v: v / 100), {}, r"measures 2\.36 mm .* Set dataset\.units=dm\."),
    "one person in cm": (everyone(lambda v: v / 10, "bob/*.obj"), {},
                         r"bob.neutral\.obj: .*about 236 mm: scale all meshes of bob by 9\.4"),
    "one person in inches": (everyone(lambda v: v / 2.54, "bob/*.obj"), {}, "probably in different units"),
    "one expression in cm": (replace("bob/smile.obj", lambda v: v / 10), {}, r"bob.smile\.obj: it measures 2[45]"),
    "a head that turns": (replace("bob/smile.obj", lambda v: moved(v, 1.2, 0.0)), {"align": "refuse"},
                          r"bob.smile\.obj: the cranium is turned by 1\.2 degrees and moved by 0\.0 mm"),
    "a head that shifts": (replace("bob/smile.obj", lambda v: moved(v, 0.0, 1.5)), {"align": "refuse"},
                           r"bob.smile\.obj: .*moved by 1\.5 mm .*dataset\.align=load"),
    "regions without a cranium": (lambda root: write_regions(root / "regions.json", Regions()), {},
                                  "nothing says which vertices the cranium has"),
    "regions of another mesh": (lambda root: write_regions(root / "regions.json", Regions({"cranium": [1, 2, 999]})),
                                {}, "it belongs to another mesh"),
    "no regions file": (lambda root: (root / "regions.json").unlink(), {}, r"expected a regions file, found none"),
    "a dented cranium": (replace("bob/smile.obj", dented), {},
                         r"bob.smile\.obj: the cranium differs from the neutral's by 1\d mm RMS"),
    "upside down": (lambda root: write_regions(root / "regions.json", upside_down()), {},
                    r"neutral\.obj: with dataset\.up and dataset\.front as they are, up points along -y"),
    "closed cache": (lambda root: write("file", "")(root.parent), {"cache": "file"}, r"dataset\.cache: cannot write"),
}  # fmt: skip


UNLIKE: dict[str, tuple[Callable[[FloatArray], FloatArray], str]] = {
    "other axes": (lambda v: v[:, [2, 0, 1]], r"turned by 1[12]\d degrees against"),
    "on its back": (lambda v: v[:, [0, 2, 1]] * [1, 1, -1], r"turned by [89]\d degrees against"),
    "mirrored": (lambda v: v * [-1, 1, 1], "mirrored against"),
    "upside down and mirrored": (lambda v: -v, "mirrored against"),
    "another order": (shuffled, r"its edges are [234]\S* times as long as those of"),
}
ALIGNED: list[dict[str, Any]] = [{}, {"align": "refuse"}, {"align": "none"}, {"align": "none", "regions": None}]


@pytest.mark.parametrize("changed", ALIGNED, ids=str)
@pytest.mark.parametrize("unlike", UNLIKE)
def test_a_person_or_a_mesh_that_is_unlike_the_others_is_refused(
    folder: Path, unlike: str, changed: dict[str, Any]
) -> None:
    change, message = UNLIKE[unlike]
    bob_as_npz(change, "smile")(folder)
    with pytest.raises(InvalidInput, match=rf"bob.smile\.npz: {message} .*bob.neutral\.obj"):
        settings(folder, **changed).load()
    (folder / "bob" / "smile.npz").unlink()
    bob_as_npz(change, "*")(folder)
    for _ in range(2):  # also from the store
        with pytest.raises(InvalidInput, match=rf"bob.neutral\.npz: {message} .*anna.neutral\.obj"):
            settings(folder, **changed).load()


def test_noisy_scans_of_heads_that_turn_far_and_faces_that_move_far_are_read(folder: Path) -> None:
    rng = np.random.default_rng(1)
    far = head("bob") + 5 * (performed("bob", "smile") - head("bob"))
    assert np.linalg.norm(far - head("bob"), axis=1).max() > 80
    far = moved(far, 50.0, 300.0) + rng.normal(0, 2, far.shape)
    write_obj(folder / "bob" / "smile.obj", far, FACES)
    for path in (folder / "anna").glob("*.obj"):
        replace(path.name, lambda v: moved(v, 40.0, 0.0))(path.parent)
    data = settings(folder).load()
    assert data.placed["bob"].degrees.max() == pytest.approx(50, abs=2)
    assert 2 < data.placed["bob"].residuals.max() < 5


def as_twice(root: Path) -> None:
    trimesh.Trimesh(head("bob"), FACES, process=False).export(root / "bob" / "smile.ply")


def upside_down() -> Regions:
    height = head("anna")[:, 1]
    return Regions({"cranium": CRANIUM}, landmarks={"nasion": int(height.argmin()), "menton": int(height.argmax())})


@pytest.mark.parametrize("mistake", MISTAKES)
def test_what_cannot_be_used_is_refused_with_the_file_and_the_mend(folder: Path, mistake: str) -> None:
    spoil, changed, message = MISTAKES[mistake]
    spoil(folder)
    if isinstance(changed.get("cache"), str):
        changed = {"cache": str(folder.parent / changed["cache"])}
    with pytest.raises(InvalidInput, match=message):
        settings(folder, **changed).load()
    assert not list(folder.parent.rglob(".*.tmp*"))  # nothing is half written
