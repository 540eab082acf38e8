"""Kinds of truth: what every one of them must keep, and what each promises."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from retarget.check import InvalidInput
from retarget.rig.deformation_transfer import DeformationTransfer, Weighting
from retarget.types import FloatArray, IntArray, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.cache import ArrayCache
from synth_data.code import ROOT, code_digest, code_files
from synth_data.makehuman.anthropometry import personalisation
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.targets import Targets
from synth_data.measure_truths import Session, distance, span_residual
from synth_data.personal.scans import unit_weights
from synth_data.truth import OPPOSITE, GenericRig, Performer, Person, Rehearsed, cast, truth_kind, truth_kinds
from synth_data.truths.ebfr_arkit import HELD, Rigger, generic_units
from synth_data.weights import blending_weights

pytestmark = pytest.mark.xdist_group("truth")  # its people perform once

Base = tuple[BaseHead, Targets, Regions]
KINDS = truth_kinds()
TOLERANCE = {"nonlinear": 0.02, "ebfr_arkit": 0.02}  # mm by which solvers and iterations may break the symmetry
WEIGHTS = blending_weights("sparse", 3)


@pytest.fixture(scope="module")
def generic(base: Base) -> GenericRig:
    return generic_rig(*base)


@pytest.fixture(scope="module")
def mirror(generic: GenericRig) -> IntArray:
    assert generic.regions.mirror is not None
    return generic.regions.mirror


@pytest.fixture(scope="module")
def persons(sampler: IdentitySampler, mirror: IntArray) -> Mapping[str, Person]:
    """Two people, and one of them in a mirror."""
    found = {f"person-{seed}": person_of(sampler(seed)) for seed in (4, 5)}
    return found | {"in the mirror": found["person-4"].mirrored(mirror)}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> ArrayCache:
    """Empty at first: nothing of this machine's own cache enters a test."""
    return ArrayCache(tmp_path_factory.mktemp("cache"))


@pytest.fixture(scope="module")
def performers(
    generic: GenericRig, persons: Mapping[str, Person], store: ArrayCache
) -> dict[str, dict[str, Performer]]:
    return {kind: cast(kind, generic, persons, WEIGHTS, store) for kind in KINDS}


@pytest.fixture(scope="module")
def session(generic: GenericRig, persons: Mapping[str, Person]) -> Session:
    return Session.of(persons["person-4"], generic)


@pytest.mark.parametrize("kind", KINDS)
def test_mouth_close_shuts_the_lips_over_a_jaw_that_is_as_open(
    performers: dict[str, dict[str, Performer]], persons: Mapping[str, Person], generic: GenericRig, kind: str
) -> None:
    lips = [generic.regions.landmarks[f"stomion_{lip}"] for lip in ("upper", "lower")]
    for name in ("person-4", "person-5"):
        for strength in (0.1, 0.6, 1.0):
            opened = unit_weights({"jawOpen": strength})
            frames = performers[kind][name](np.array([opened, opened + unit_weights({"mouthClose": strength})]))
            rest, parted, shut = (
                np.linalg.norm(np.subtract(*frame[lips])) for frame in (persons[name].neutral, *frames)
            )
            assert abs(shut - rest) < 0.06 * (parted - rest), (name, strength)


def test_the_kinds_are_the_files_and_each_says_what_it_favours() -> None:
    assert KINDS == ("additive", "ebfr_arkit", "nonlinear", "personal_blendshapes")
    for kind in KINDS:
        assert len(truth_kind(kind).favours) > 100
    with pytest.raises(InvalidInput, match=r"dataset\.truth: 'nonlinaer' is unknown.*Did you mean 'nonlinear'"):
        truth_kind("nonlinaer")


@pytest.mark.parametrize("kind", KINDS)
def test_zero_weights_give_the_neutral_bit_for_bit(
    kind: str, performers: dict[str, dict[str, Performer]], persons: Mapping[str, Person]
) -> None:
    for name, person in persons.items():
        np.testing.assert_array_equal(performers[kind][name](np.zeros((1, 51)))[0], person.neutral)
        assert np.abs(performers[kind][name](WEIGHTS) - person.neutral).max() > 3  # mm


@pytest.mark.parametrize("kind", KINDS)
def test_mirrored_weights_on_a_mirrored_person_give_the_mirrored_mesh(
    kind: str, performers: dict[str, dict[str, Performer]], mirror: IntArray
) -> None:
    seen = performers[kind]["person-4"](WEIGHTS)[:, mirror] * (-1, 1, 1)
    image = performers[kind]["in the mirror"](WEIGHTS[:, OPPOSITE])
    np.testing.assert_allclose(image, seen, rtol=0, atol=TOLERANCE.get(kind, 1e-9))
    assert np.abs(performers[kind]["in the mirror"](WEIGHTS) - seen).max() > 0.5  # mm: the weights are not symmetric


def test_same_person_and_weights_same_bits_with_and_without_a_cache(
    generic: GenericRig, persons: Mapping[str, Person], performers: dict[str, dict[str, Performer]]
) -> None:
    alone = {"person-4": persons["person-4"]}
    for kind in KINDS:
        again = cast(kind, generic, alone, WEIGHTS, ArrayCache())["person-4"](WEIGHTS)
        np.testing.assert_array_equal(again, performers[kind]["person-4"](WEIGHTS), err_msg=kind)


def test_performers_travel_to_other_processes(performers: dict[str, dict[str, Performer]]) -> None:
    for kind in KINDS:
        there = pickle.loads(pickle.dumps(performers[kind]["person-4"]))
        np.testing.assert_array_equal(there(WEIGHTS), performers[kind]["person-4"](WEIGHTS))


def test_people_move_differently_but_for_the_additive_kind(
    performers: dict[str, dict[str, Performer]], persons: Mapping[str, Person], generic: GenericRig
) -> None:
    """So neither delta transfer nor deformation transfer has no error on any other kind."""
    region = generic.regions.vertices["head"]
    one, other = persons["person-4"], persons["person-5"]
    transfer = DeformationTransfer(
        one.neutral, other.neutral, generic.faces, generic.regions.vertices["cranium"], Weighting.AREA
    )
    for kind in KINDS:
        source, target = (performers[kind][name](WEIGHTS) for name in ("person-4", "person-5"))
        delta = source - one.neutral
        share = personalisation(delta, target - other.neutral, region)
        copied = distance(target - other.neutral - delta, region)
        transferred = distance(target - transfer(source), region)
        if kind == "additive":
            assert copied < 1e-9
        else:
            assert 0.15 < share < 0.6, kind
            assert min(copied, transferred) > 0.1, kind  # mm


def test_linear_kinds_are_linear_and_the_others_are_not(performers: dict[str, dict[str, Performer]]) -> None:
    both = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]]) @ np.stack(
        [[float(name.startswith(unit)) for name in SKIN_NAMES] for unit in ("jawOpen", "mouthSmile")]
    )
    for kind in KINDS:
        perform = performers[kind]["person-4"]
        a, b, sum_ = perform(both) - perform(np.zeros((1, 51)))
        missed = np.linalg.norm(sum_ - a - b) / np.linalg.norm(sum_)
        assert missed > 0.02 if kind == "nonlinear" else missed < 1e-12, kind


def test_rigs_predict_scans_that_were_held_out_better_than_deformation_transfer(
    generic: GenericRig, session: Session, store: ArrayCache
) -> None:
    region = generic.regions.vertices["head"]
    out = np.arange(len(session.frames)) % 4 == 1
    rigger = Rigger(generic, generic_units(generic, store), HELD)
    rig = rigger(session.neutral, session.frames[~out], session.weights[~out])
    plain = rigger(session.neutral, session.frames[:0], session.weights[:0])
    motion = distance(session.motions[out], region)
    without, transferred = (distance(session.missed(deltas)[out], region) for deltas in (rig, plain))
    given = distance(session.missed(rig)[~out], region)
    assert given < 0.15 * motion
    assert without < 0.4 * motion
    assert without < 0.9 * transferred


def test_without_scans_a_rig_is_deformation_transfer(generic: GenericRig, session: Session, store: ArrayCache) -> None:
    units = generic_units(generic, store)
    rig = Rigger(generic, units, HELD)(session.neutral, session.frames[:0], session.weights[:0])
    transfer = DeformationTransfer(
        generic.neutral, session.neutral, generic.faces, generic.regions.vertices["cranium"], Weighting.AREA
    )
    np.testing.assert_allclose(rig, transfer.displacements(generic.neutral + units), atol=1e-9)


def test_scans_lie_outside_of_the_span_of_the_generic_rig(
    generic: GenericRig, session: Session, store: ArrayCache
) -> None:
    region = generic.regions.vertices["head"]
    for deltas in (generic.deltas, generic_units(generic, store)):
        residual, share = span_residual(session.motions, deltas, region)
        assert residual > 0.3  # mm
        assert share > 0.08


def test_span_residual_by_hand() -> None:
    """Two units along x and y of one vertex of two: what moves along z, or the other vertex, is outside."""
    deltas = np.zeros((2, 2, 3))
    deltas[0, 0, 0] = deltas[1, 0, 1] = 2
    motions = np.array([[[5, 1, 0], [0, 0, 0]], [[1, 0, 3], [0, 4, 0]]], dtype=float)
    found = span_residual(motions, deltas, np.array([0, 1]))
    np.testing.assert_allclose(found, (np.sqrt(25 / 4), np.sqrt(25 / 52)))


def test_the_generic_rig_is_checked_and_symmetric(generic: GenericRig, mirror: IntArray) -> None:
    np.testing.assert_array_equal(generic.deltas[OPPOSITE][:, mirror] * (-1, 1, 1), generic.deltas)
    with pytest.raises(InvalidInput, match="one for each of the 51 units that move skin, got 50"):
        GenericRig(generic.neutral, generic.faces, generic.deltas[:50], generic.regions)
    with pytest.raises(InvalidInput, match="mirror"):
        GenericRig(generic.neutral, generic.faces, generic.deltas, Regions()).symmetrised()


def test_a_rehearsed_performance_is_made_once(tmp_path: Path) -> None:
    asked: list[int] = []

    def perform(weights: FloatArray) -> FloatArray:
        asked.append(len(weights))
        return np.repeat(weights[:, :1, None], 3, axis=2)

    performer = Rehearsed(perform, "somebody", ArrayCache(tmp_path))
    weights = np.arange(20.0)[:, None]
    first, second = performer(weights), performer(weights)
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(first[:, 0, 0], weights[:, 0])
    assert asked == [20]
    performer(weights[:3])  # too short to be kept
    performer(weights + 1)
    assert asked == [20, 3, 20]


def test_the_cache_survives_damage_and_closed_folders(tmp_path: Path) -> None:
    made: list[int] = []

    def make() -> FloatArray:
        made.append(1)
        return np.eye(3)

    cache = ArrayCache(tmp_path / "new")
    np.testing.assert_array_equal(cache("a", make), np.eye(3))
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["a.npy"]
    cache("a", make)
    assert len(made) == 1
    for damage in (b"", b"\x93NUMPY\x01", (tmp_path / "new" / "a.npy").read_bytes()[:-9]):
        (tmp_path / "new" / "a.npy").write_bytes(damage)
        np.testing.assert_array_equal(cache("a", make), np.eye(3))
    assert len(made) == 4
    np.save(tmp_path / "new" / "a.npy", np.array([{}], dtype=object), allow_pickle=True)
    np.testing.assert_array_equal(cache("a", make), np.eye(3))  # nothing is unpickled
    (tmp_path / "file").write_text("")
    np.testing.assert_array_equal(ArrayCache(tmp_path / "file")("a", make), np.eye(3))
    np.testing.assert_array_equal(ArrayCache()("a", make), np.eye(3))
    assert len(made) == 7


def test_the_cache_forgets_what_was_not_read_for_longest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("synth_data.cache.LARGEST", 2500)
    cache = ArrayCache(tmp_path)
    for number, key in enumerate("abc"):
        cache(key, lambda: np.zeros(100))  # 928 bytes
        os.utime(tmp_path / f"{key}.npy", (number, number))
    assert sorted(path.stem for path in tmp_path.iterdir()) == ["b", "c"]


def test_the_fingerprint_covers_all_code_that_a_dataset_loads() -> None:
    """What a fresh interpreter has loaded of this project is what was found by reading its imports, or less."""
    code = (
        "import sys, importlib, synth_data.makehuman.dataset, synth_data.truth as t\n"
        "[t.truth_kind(kind) for kind in t.truth_kinds()]\n"
        "own = [m for name, m in sys.modules.items() if name.split('.')[0] in ('synth_data', 'retarget')]\n"
        "print(*(module.__file__ for module in own), sep='\\n')"
    )
    loaded = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout.split("\n")
    found = set(code_files("synth_data.truths", "synth_data.makehuman"))
    assert {Path(file) for file in loaded if file} <= found
    names = {file.relative_to(ROOT).as_posix() for file in found}
    assert {"retarget/rig/ebfr.py", "synth_data/personal/face.py", "synth_data/makehuman/regions.json"} <= names
    assert not {name for name in names if "author_" in name or "ict_facekit" in name or name.startswith("retarget/sim")}


def test_the_fingerprint_follows_the_code_it_covers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package in ("synth_data/kinds", "retarget"):
        (tmp_path / package).mkdir(parents=True)
        (tmp_path / package / "__init__.py").touch()
    (tmp_path / "synth_data/kinds/one.py").write_text("def f():\n    from retarget import used\n")
    for name in ("used", "unused"):
        (tmp_path / f"retarget/{name}.py").write_text("x = 1")
    monkeypatch.setattr("synth_data.code.ROOT", tmp_path)
    digest = code_digest.__wrapped__
    before = digest("synth_data.kinds")
    (tmp_path / "retarget/unused.py").write_text("x = 2")
    assert digest("synth_data.kinds") == before
    (tmp_path / "retarget/used.py").write_text("x = 2")
    assert digest("synth_data.kinds") != before


def test_the_kind_of_the_docs_page_is_a_kind(
    generic: GenericRig, persons: Mapping[str, Person], monkeypatch: pytest.MonkeyPatch
) -> None:
    page = (Path(__file__).parents[2] / "docs" / "truths.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    module = ModuleType("half")
    monkeypatch.setitem(sys.modules, "half", module)
    exec(code, module.__dict__)
    person = persons["person-4"]
    frames = module.TRUTH.prepare(generic, ArrayCache(), print)(person)(np.eye(51)[:2])
    np.testing.assert_allclose(frames, person.neutral + 0.5 * generic.deltas[:2])
