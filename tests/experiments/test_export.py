"""The command `export` on toy identities whose truth is known; the writers have tests of their own."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from hydra.errors import InstantiationException
from omegaconf import OmegaConf
from rich.console import Console

from experiments.catalogue import composed
from experiments.export.command import export
from experiments.export.motion import in_turn, select, taken
from retarget.check import InvalidInput
from retarget.io.npz import read_npz
from retarget.types import FloatArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.conversation import conversation
from synth_data.dataset import DatasetConfig, Progress
from synth_data.mesh_folder.dataset import MeshFolder
from synth_data.performed import PerformedConfig, Troupe
from tests.experiments.toy import Toy, toy
from tests.reports.example_study import write_example_study
from tests.retarget.io.glb import Glb


@dataclass(frozen=True)
class RiggedToy(Toy):
    """Its units blend linearly, or with `bend` mm added where two of them are worn together."""

    bend: float = 0.0

    def perform(self, identity: str, weights: FloatArray) -> FloatArray:
        linear = self.neutrals[identity] + np.tensordot(weights, self.units[identity], axes=1)
        together = weights.sum(axis=1) ** 2 - (weights**2).sum(axis=1)
        return linear + self.bend * together[:, None, None] * [0.0, 0.0, 1.0]

    def frames(self, identity: str, indices: object) -> FloatArray:
        return self.perform(identity, self.weights[list(indices)])  # type: ignore[call-overload]


@dataclass(frozen=True)
class Heads(DatasetConfig):
    bend: float = 0.0
    rigs: bool = True
    line: str = "heads"

    def load(self, progress: Progress = lambda line: None) -> Toy:
        progress(self.line)
        plain = toy(identities=3, expressions=12, units=len(SKIN_NAMES), subdivisions=2)
        values = {field.name: getattr(plain, field.name) for field in fields(plain)}
        return RiggedToy(**values, bend=self.bend) if self.rigs else plain


Run = Callable[..., tuple[Path, str]]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    monkeypatch.chdir(tmp_path)

    def call(*overrides: str, **dataset: object) -> tuple[Path, str]:
        config = composed("export", list(overrides))
        config.dataset = OmegaConf.create({"_target_": f"{__name__}.Heads", **dataset})
        said = io.StringIO()
        return export(config, Console(file=said, width=300)), said.getvalue()

    return call


def test_truth_is_an_animation_of_all_expressions(run: Run) -> None:
    path, said = run()
    assert path.name == "truth-linear-a.glb"
    assert "12 key frames" in said
    glb, data = Glb.read(path), Heads().load()
    for k in (0, 7):
        shown = glb.shape(0, glb.weights(0, k / 2))  # two expressions per second
        np.testing.assert_allclose(1e3 * shown, data.frames("a", [k])[0], atol=2e-5)
    assert glb.scene["meshes"][0]["extras"]["targetNames"] == list(data.expressions)
    assert glb.scene["scenes"][0]["extras"]["truth"] == "linear"


def test_a_rig_has_all_units_by_their_names_and_plays_the_take(run: Run) -> None:
    path, _ = run("what=rig", "take=conversation", "seconds=2", "identity=b")
    glb, data = Glb.read(path), Heads().load()
    assert glb.scene["meshes"][0]["extras"]["targetNames"] == list(NAMES)
    unit = np.eye(len(NAMES))[NAMES.index("jawOpen")]
    expected = data.neutral("b") + data.units["b"][SKIN_NAMES.index("jawOpen")]
    np.testing.assert_allclose(1e3 * glb.shape(0, unit), expected, atol=2e-5)
    tongue = np.eye(len(NAMES))[NAMES.index("tongueOut")]
    np.testing.assert_array_equal(glb.shape(0, tongue), glb.shape(0, np.zeros(len(NAMES))))
    take = conversation(2.0, 30.0)
    np.testing.assert_allclose(glb.weights(0, 1.1), take.at([1.1])[0], atol=1e-6)
    assert glb.scene["nodes"][0]["extras"]["linear"] is True


def test_a_rig_says_how_far_its_blends_are_from_a_truth_that_is_not_linear(run: Run) -> None:
    path, said = run("what=rig", bend=0.5)
    about = Glb.read(path).scene["nodes"][0]["extras"]
    assert about["linear"] is False
    assert "frames of single units" in about["note"]
    data = Heads(bend=0.5).load()
    together = data.weights.sum(axis=1) ** 2 - (data.weights**2).sum(axis=1)
    assert f"up to {0.5 * together.max():.2g} mm" in said


def test_retargeted_frames_stand_beside_source_and_truth(run: Run) -> None:
    path, _ = run("what=retargeted", "method=[delta]", "n_examples=3", "source=c", "target=a", "frames=0:4")
    glb, data = Glb.read(path), Heads().load()
    assert [node["name"] for node in glb.scene["nodes"]] == ["source", "truth", "delta"]
    source, truth = data.frames("c", [3])[0], data.frames("a", [3])[0]
    delta = data.neutral("a") + source - data.neutral("c")
    for mesh, expected in enumerate((source, truth, delta)):
        shown = glb.shape(mesh, glb.weights(mesh, 1.5))
        np.testing.assert_allclose(1e3 * shown, expected, atol=2e-5)
    assert len(glb.scene["scenes"][0]["extras"]["examples"]) == 3


def test_stored_frames_of_a_study_are_exported_without_running_a_method(run: Run, tmp_path: Path) -> None:
    study = write_example_study(tmp_path / "study")
    folder, _ = run("what=retargeted", f"from={study}", "method=[plbs,delta]", "n_examples=15", "format=npz")
    stored = next(path for path in study.glob("*/frames.npz"))
    with np.load(stored) as archive:
        source = archive["source"]
    assert {path.name for path in folder.iterdir()} == {
        "source.npz", "truth.npz", "plbs.npz", "delta.npz", "export.json",
    }  # fmt: skip
    np.testing.assert_array_equal(read_npz(folder / "source.npz")[1].shapes, source)
    with pytest.raises(InvalidInput, match="n_examples=15"):
        run("what=retargeted", f"from={study}", "method=[plbs]", "n_examples=7")


def test_an_obj_export_is_a_folder_of_people_that_reads_back(run: Run, tmp_path: Path) -> None:
    folder, _ = run("format=obj", "identity=all", "frames=0:3", f"output={tmp_path / 'people'}")
    back = MeshFolder(root=str(folder), align="none", cache=str(tmp_path / "cache"), jobs=1).load()
    data = Heads().load()
    assert back.identities == data.identities
    for name in back.identities:
        np.testing.assert_allclose(back.neutral(name), data.neutral(name), atol=1e-5)
        np.testing.assert_allclose(back.frames(name, range(3)), data.frames(name, range(3)), atol=1e-5)


def test_nothing_is_overwritten_unasked(run: Run, tmp_path: Path) -> None:
    path, _ = run("frames=0:2")
    before = path.read_bytes()
    with pytest.raises(InvalidInput, match="overwrite=true"):
        run("frames=0:3")
    assert path.read_bytes() == before
    run("frames=0:3", "overwrite=true")
    assert path.read_bytes() != before
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "thesis.txt").write_text("")
    with pytest.raises(InvalidInput, match="left alone"):
        run("format=obj", f"output={mine}", "overwrite=true")
    assert (mine / "thesis.txt").exists()


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["what=truht"], "Did you mean 'truth'"),
        (["format=gltf"], "expected one of glb, obj, npz"),
        (["identity=z"], "expected one of a, b, c"),
        (["what=retargeted", "source=z"], "source: 'z' is unknown, expected one of a, b, c"),
        (["identity=[a,a]"], "each once"),
        (["identity=1"], "identity: '1' is unknown, expected one of a, b, c"),
        (["identity=[]"], "one or more"),
        (["identity={a: b}"], "identity: "),
        (["what=retargeted", "source=1"], "source: '1' is unknown"),
        (["normals=maybe"], "normals: expected true or false, got 'maybe'"),
        (["overwrite=maybe"], "overwrite: expected true or false, got 'maybe'"),
        (["overwrite=1"], "overwrite: expected true or false, got 1"),
        (["most_targets=many"], "most_targets: expected a whole number of at least 1, got 'many'"),
        (["fps=true"], "fps: expected a positive number or null, got True"),
        (["output=5"], "output: expected a path or null, got 5"),
        (["what=retargeted", "from=5"], "from: expected a path or null, got 5"),
        ([f"take={300 * 'x'}"], "found no file 'xxx"),
        (["frames=99"], "from 0 to 11"),
        (["frames=7:2"], "ascending"),
        (["frames=expression_02"], "Did you mean 'expression_0"),
        (["most_targets=5"], "frames=0:5 or frames=::3"),
        (["fps=0"], "fps"),
        (["seconds=3"], "take"),
        (["take=nowhere.csv"], "nowhere.csv"),
        (["output=face.obj"], "ends in .glb"),
        (["from=results/ci"], "what=retargeted"),
        (["what=retargeted", "source=a", "target=a"], "another identity"),
        (["what=retargeted", "n_examples=30"], "^n_examples: 30 .*test_expressions.* at most 7 .* n_examples=7,"),
        (["what=retargeted", "n_examples=1", "test_expressions=12"], "at most 0 are left. Hold out fewer"),
    ],
)
def test_what_cannot_be_exported_is_told_in_words(run: Run, tmp_path: Path, overrides: list[str], said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        run(*overrides)
    assert not list(tmp_path.rglob("*.glb"))


@dataclass(frozen=True)
class Announced(PerformedConfig):
    """Its people and expressions have names before anybody is made."""

    name: ClassVar[str] = "announced"

    def source(self) -> str:
        return ""

    def troupe(self, progress: Progress) -> Troupe:
        raise AssertionError("people were made")


TAKE = ["Timecode,BlendShapeCount," + ",".join(name[0].upper() + name[1:] for name in NAMES)]
TAKE += [f"00:00:00:{k:02d},61," + ",".join(["0.5", "-0.1", *["0"] * 50]) for k in range(2)]


@pytest.mark.parametrize(
    ("overrides", "said"),
    [
        (["identity=nobody"], "identity: 'nobody' is unknown, expected one of person-000"),
        (["frames=7:2"], "ascending"),
        (["frames=recombined-01"], "Did you mean 'recombined-0"),
        (["dataset.expressions=300"], "frames: 300 frames, each a morph target"),
        (["take=nowhere.csv"], "nowhere.csv"),
        (["take=cut.csv"], "cut.csv, line 2: expected 54 values"),
        (["take=conversation", "seconds=1", "frames=30"], "from 0 to 29"),
        (["take=conversation"], "300 frames"),
        (["dataset.truth=null"], "dataset.truth: expected one of"),
        (["format=npz", "identity=all", "output=faces.npz"], "output: expected a folder"),
        (["what=rig", "identity=nobody"], "identity: 'nobody'"),
        (["what=rig", "take=cut.csv"], "cut.csv"),
        (["what=rig", "frames=99"], "from 0 to 11"),
        (["what=retargeted", "target=nobody"], "target: 'nobody'"),
        (["what=retargeted", "n_examples=8"], "at most 7 are left"),
        (["what=retargeted", "n_examples=3", "frames=99"], "from 0 to 11"),
        (["what=retargeted", "method.anacondar.smooth=1"], "anacondar"),
        (["what=retargeted", "dataset.identities=1"], "at least 2"),
        ([], "truth-ebfr_arkit-person-000.glb: is there already"),
        (["what=rig"], "rig-ebfr_arkit-person-000.glb: is there already"),
        (["what=retargeted", "n_examples=3"], "anacondar-person-000-to-person-001.glb: is there already"),
    ],
)
def test_what_can_be_known_is_told_before_people_are_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, overrides: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "cut.csv").write_text("\n".join([TAKE[0], TAKE[1][:40]]))
    (tmp_path / "exports").mkdir()
    for name in ("truth-ebfr_arkit-person-000", "rig-ebfr_arkit-person-000", "anacondar-person-000-to-person-001"):
        (tmp_path / "exports" / f"{name}.glb").touch()
    added = [f"+{each}" if each.startswith("method.anacondar.smooth") else each for each in overrides]
    config = composed("export", ["dataset.expressions=12", "dataset.identities=3", *added])
    settings = {field.name: config.dataset[field.name] for field in fields(Announced)}
    config.dataset = OmegaConf.create({"_target_": f"{__name__}.Announced", **settings})
    with pytest.raises((InvalidInput, InstantiationException), match=said):
        export(config, Console(file=io.StringIO()))


def test_names_with_brackets_are_printed_as_they_are(run: Run, tmp_path: Path) -> None:
    """As the line of a dataset about a folder, and as the name of a method."""
    _, said = run("frames=0:2", line="folder [/b] of [bold]people")
    assert "  folder [/b] of [bold]people\n" in said
    config = composed("export", ["what=retargeted", "method=[delta]", "n_examples=3"])
    config.dataset = OmegaConf.create({"_target_": f"{__name__}.Heads"})
    config.method = OmegaConf.create({"[/b]": config.method.delta})
    export(config, Console(file=(told := io.StringIO()), width=300))
    said = told.getvalue()
    assert "[/b]: set-up for the pair" in said
    assert "source, truth, [/b]: " in said


def test_a_take_of_a_file_is_told_and_noted_with_what_was_mended(run: Run, tmp_path: Path) -> None:
    (tmp_path / "mine.csv").write_text("\n".join(TAKE))
    path, said = run("take=mine.csv")
    summary = "mine: 2 rows, 0 lost, 2 clipped (values from -0.1 to 0.5)"
    assert f"take {summary}" in said
    assert Glb.read(path).scene["scenes"][0]["extras"]["recording"].startswith(summary)


def test_scans_have_no_rig(run: Run) -> None:
    for what in (["what=rig"], ["take=conversation"]):
        with pytest.raises(InvalidInput, match="without rigs"):
            run(*what, rigs=False)


def test_a_take_keeps_its_rate_or_gets_another() -> None:
    own, slow = taken("conversation", seconds=2.0), taken("conversation", seconds=2.0, fps=10)
    np.testing.assert_allclose(own.times, np.arange(60) / 30)
    np.testing.assert_allclose(slow.weights[5], own.weights[15], atol=1e-12)
    part = taken("conversation", "30:60:3", seconds=2.0)
    assert part.times[0] == 0
    np.testing.assert_array_equal(part.weights, own.weights[30:60:3])


def test_frames_are_chosen_by_number_name_or_slice() -> None:
    names = ["a", "b", "c", "d"]
    for frames, expected in ((None, [0, 1, 2, 3]), ("1:3", [1, 2]), ("::2", [0, 2]), (2, [2]), (["a", 3], [0, 3])):
        assert select(frames, names) == expected
    assert in_turn(Heads().load(), "0:2", fps=4).times.tolist() == [0, 0.25]
