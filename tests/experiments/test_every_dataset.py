"""Every study on every dataset and kind of truth: what runs, and what is refused with the reason and the mend."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hydra.utils import instantiate
from rich.console import Console

from experiments.catalogue import composed, options
from experiments.export.command import export
from experiments.run import run
from retarget.check import InvalidInput
from retarget.io.npz import read_npz
from retarget.io.regions import write_regions
from synth_data.dataset import DatasetConfig
from synth_data.ict_facekit.clone import FOLDER
from synth_data.makehuman.regions import load_regions
from synth_data.truth import truth_kinds

pytestmark = pytest.mark.xdist_group("every-dataset")

ARCHIVE = Path(__file__).parents[3] / "shared/data/ict_facekit/ict_facekit_subset.tar.xz"
EXPRESSIONS = 8
PEOPLE = ["scale.identities=2", "scale.subdivisions=0", f"dataset.expressions={EXPRESSIONS}"]
TINY = ["study.n_examples=[4]", "study.test_expressions=2", "study.draws=1", "study.figures.pairs=0", "report=false"]
LEAN = ["backend=serial", "metric=[vertex_l2]"]
FEW = ["study.pairs=1", "study.expressions=2"]
SMALL = {  # the studies that are no comparison, for two people and eight expressions, and what they write
    "runtime": (["study.template=coarse", "study.blendshapes=2", "study.animation_frames=50"], "frames.csv"),
    "collision": ([*FEW, "study.n_examples=4", "study.expressions=4", "study.depth=1.0e-4"], "cases.csv"),
    "artistic": (["study.n_examples=4", "study.edits={Gravity:{gravity:[0.0,9.81,0.0]}}"], "artistic.pdf"),
    "alm_shapes": ([*FEW, "study.shapes=4", "study.counts=[2,4]"], "summary.csv"),
    "alm_overlap": ([*FEW, "study.shapes=4", "study.rings=[0,1]", "study.lambda_overlap=[0.0,100.0]"], "summary.csv"),
    "alm_leave_out": ([*FEW, "study.shapes=4", "study.folds=2", "study.shown=1", "method=[alm,lbs]"], "summary.csv"),
    "temporal": ([*TINY, "study.seconds=7", "study.noise_frames=2", "method=[delta,lbs]"], "temporal.pdf"),
}


def quiet() -> Console:
    return Console(file=io.StringIO(), width=200)


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Settings of a folder of meshes that the export wrote, with its regions."""
    root = tmp_path_factory.mktemp("scans")
    asked = ["format=obj", "identity=all", f"output={root / 'heads'}", *PEOPLE, "dataset.truth=personal_blendshapes"]
    export(composed("export", asked), quiet())
    write_regions(root / "regions.json", load_regions())
    where = [f"dataset.root={root / 'heads'}", f"dataset.cache={root / 'cache'}", "dataset.jobs=1"]
    return ["dataset=mesh_folder", *where, f"dataset.regions={root / 'regions.json'}"]


@pytest.fixture(scope="module")
def bare(scans: list[str]) -> list[str]:
    """The same without its regions."""
    return [*scans, "dataset.regions=null", "dataset.align=none"]


@pytest.fixture(scope="module")
def heads() -> list[str]:
    return ["dataset=makehuman", *PEOPLE]


@pytest.fixture(scope="module")
def ict(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    if not ARCHIVE.exists():
        pytest.skip("no copy of ICT-FaceKit beside the checkout")
    root = tmp_path_factory.mktemp("ict")
    with tarfile.open(ARCHIVE) as archive:
        archive.extractall(root, filter="data")
    clone = next(root.rglob(FOLDER)).parent
    return ["dataset=ict_facekit", f"dataset.root={clone}", f"dataset.cache={root / 'cache'}", *PEOPLE]


@pytest.mark.parametrize("study", options("study"))
def test_no_study_sets_what_a_folder_of_meshes_does_not_have(study: str) -> None:
    config = composed("run", [f"study={study}", "dataset=mesh_folder"])
    assert isinstance(instantiate(config.dataset), DatasetConfig)


def compared(settings: Sequence[str], folder: Path) -> pd.DataFrame:
    """Status, reason and mean error in mm of each method."""
    run(composed("run", ["method=[delta,lbs,landmark_dt]", *TINY, *LEAN, *settings]), folder, quiet())
    metrics = pd.read_parquet(folder / "metrics.parquet")
    errors = metrics[(metrics["metric"] == "vertex_l2_mean") & (metrics["region"] == "head")]
    told = pd.read_parquet(folder / "cells.parquet").groupby("method")[["status", "reason"]].first()
    return told.assign(mm=errors.groupby("method")["value"].mean())


def check(table: pd.DataFrame, *, additive: bool = False) -> None:
    """All methods answer, and none is the truth unless it owns it."""
    assert (table["status"] == "ok").all(), table
    errors = {str(method): float(error) for method, error in table["mm"].items()}
    assert all(errors[method] < 2 * errors["neutral"] for method in ("delta", "lbs", "landmark_dt")), table
    assert errors["lbs"] > 0.01
    assert errors["landmark_dt"] > 0.01
    assert errors["delta"] < 1e-9 if additive else errors["delta"] > 0.01


@pytest.mark.parametrize(
    "truth", [pytest.param(kind, marks=pytest.mark.slow if kind != "additive" else ()) for kind in truth_kinds()]
)
def test_a_comparison_on_every_kind_of_truth(truth: str, tmp_path: Path) -> None:
    table = compared([*PEOPLE, f"dataset.truth={truth}", f"dataset.cache={tmp_path / 'cache'}"], tmp_path / "out")
    check(table, additive=truth == "additive")


@pytest.mark.slow
@pytest.mark.parametrize("study", SMALL)
@pytest.mark.parametrize("data", ["heads", "ict", "scans"])
def test_the_other_studies_on_every_dataset(
    data: str, study: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if (data, study) == ("scans", "temporal"):
        pytest.skip("scans have no rigs: refused, see below")
    small, written = SMALL[study]
    truth = [] if data == "scans" else ["dataset.truth=additive"]
    asked = [f"study={study}", *small, *request.getfixturevalue(data), *truth]
    try:
        run(composed("run", asked), tmp_path, quiet())
    except InvalidInput as error:
        if "none of 4 expressions makes the lips cross" not in str(error):  # of so few perhaps none is a case
            raise
    else:
        assert (tmp_path / written).exists()


def test_patches_without_anatomy_need_no_regions(bare: list[str], tmp_path: Path) -> None:
    small, written = SMALL["alm_overlap"]
    run(composed("run", ["study=alm_overlap", *small, *bare]), tmp_path, quiet())
    assert set(pd.read_csv(tmp_path / written)["variable"]) == {"rings", "lambda_overlap"}


@pytest.mark.parametrize(
    ("study", "data"),
    [
        ("weights", "heads"),
        ("noise", "scans"),
        pytest.param("truths", "heads", marks=pytest.mark.slow),
        pytest.param("truths", "ict", marks=pytest.mark.slow),
        pytest.param("weights", "ict", marks=pytest.mark.slow),
    ],
)
def test_conditions_on_the_datasets_that_have_them(
    study: str, data: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    truth = ["dataset.truth=additive"] if study == "weights" else []
    asked = [f"study={study}", "method=[delta,lbs]", *TINY, *LEAN, *request.getfixturevalue(data), *truth]
    config = composed("run", asked)
    run(config, tmp_path, quiet())
    for condition in config.study.conditions:
        assert (pd.read_parquet(tmp_path / condition / "cells.parquet")["status"] == "ok").all()


@pytest.mark.parametrize(
    ("data", "truth"),
    [
        ("heads", "additive"),
        pytest.param("heads", "nonlinear", marks=pytest.mark.slow),
        pytest.param("heads", "ebfr_arkit", marks=pytest.mark.slow),
        pytest.param("ict", "additive", marks=pytest.mark.slow),
        pytest.param("ict", "ebfr_arkit", marks=pytest.mark.slow),
    ],
)
def test_rigs_and_truths_are_exported(data: str, truth: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    asked = ["format=npz", "frames=0:3", f"dataset.truth={truth}", *request.getfixturevalue(data)]
    loaded = instantiate(composed("run", [*request.getfixturevalue(data), f"dataset.truth={truth}"]).dataset).load()
    truths = read_npz(export(composed("export", [*asked, f"output={tmp_path / 'truth.npz'}"]), quiet()))[1]
    frames = loaded.frames("person-000", [0, 1, 2])
    np.testing.assert_allclose(truths.shapes, frames, atol=1e-4)
    rig = read_npz(export(composed("export", ["what=rig", *asked, f"output={tmp_path / 'rig.npz'}"]), quiet()))[1]
    blended = np.stack([rig.at(k) for k in range(3)])
    assert np.allclose(blended, frames, atol=1e-3) == (truth != "nonlinear")


def test_a_comparison_on_ict_facekit(ict: list[str], tmp_path: Path) -> None:
    check(compared([*ict, "dataset.truth=additive"], tmp_path), additive=True)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_a_comparison_on_a_folder_of_meshes(scans: list[str], tmp_path: Path, noise: float) -> None:
    check(compared([*scans, f"dataset.noise_mm={noise}"], tmp_path))


def test_without_regions_a_method_that_needs_them_is_unsupported_and_says_why(bare: list[str], tmp_path: Path) -> None:
    table = compared([*bare, "method=[delta,lbs,landmark_dt,adt,alm,anacondar]"], tmp_path)
    assert (table.loc[["delta", "lbs"], "status"] == "ok").all()
    for method, reason in {
        "landmark_dt": "landmarks",
        "adt": "regions",
        "alm": "regions",
        "anacondar": "regions",
    }.items():
        assert table.loc[method, "status"] == "unsupported"
        said = str(table.loc[method, "reason"])
        assert reason in said
        assert "docs/own_topology.md" in said
        assert len(said) < 160
    assert table.loc[["landmark_dt", "adt", "alm", "anacondar"], "mm"].isna().all()


@pytest.mark.parametrize(
    ("chosen", "reference"), [("delta,plbs,adt,anacondar", "plbs"), ("delta,lbs,anacondar", "delta")]
)
def test_every_row_is_compared_with_a_method_that_has_a_result(
    bare: list[str], tmp_path: Path, chosen: str, reference: str
) -> None:
    """The default reference needs regions: a folder without them gets the next one, unless it was asked for."""
    compared([*bare, f"method=[{chosen}]"], tmp_path)
    assert json.loads((tmp_path / "study.json").read_text())["reference"] == reference
    assert pd.read_csv(tmp_path / "summary.csv")["ratio"].notna().any()
    compared([*bare, f"method=[{chosen}]", "study.reference=anacondar"], tmp_path)
    assert json.loads((tmp_path / "study.json").read_text())["reference"] == "anacondar"
    assert pd.read_csv(tmp_path / "summary.csv")["ratio"].isna().all()


def test_settings_are_tuned_on_a_folder_of_meshes(scans: list[str], tmp_path: Path) -> None:
    lean = [setting for setting in TINY if "figures" not in setting]
    lean += ["method=[delta]", "~study.variants", "~study.spaces", "study.trials=1", "backend=serial"]
    lean += ["+study.spaces={lbs:{lambda_reg:{log:[1.0e-8,1.0]}}}"]
    run(composed("run", ["study=tuning", *lean, *scans]), tmp_path, quiet())
    assert (tmp_path / "chosen.yaml").exists()


def test_shapes_are_left_out_by_the_methods_that_serve(bare: list[str], tmp_path: Path) -> None:
    out = quiet()
    tiny = ["study.pairs=1", "study.shapes=4", "study.expressions=2", "study.folds=2", "study.shown=0"]
    run(composed("run", ["study=alm_leave_out", "method=[alm,delta,lbs]", *tiny, *bare]), tmp_path, out)
    assert "left out: alm, " in out.file.getvalue()  # type: ignore[attr-defined]
    assert list(pd.read_csv(tmp_path / "summary.csv")["method"]) == ["delta", "lbs"]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        (["study=quantitative"], r"the dataset has 8 expressions.*'study.n_examples=\[3\]'"),
        (["study=temporal"], "needs identities that perform any blending weights.*dataset=makehuman"),
        (["study=truths"], "values of the setting 'truth', which the chosen dataset has not.*dataset=makehuman"),
        (["study=weights"], "values of the setting 'weights', which the chosen dataset has not.*dataset=makehuman"),
        (["study=artistic", "study.n_examples=2"], "method anacondar cannot serve this dataset: regions"),
        (
            ["study=collision", "study.n_examples=2", "study.expressions=2"],
            "method anacondar cannot serve this dataset",
        ),
        (["study=collision"], "expected at least 55 expressions.*study.expressions and study.n_examples"),
        (["study=runtime", "study.blendshapes=2"], "method anacondar cannot serve this dataset: regions"),
        (["study=runtime"], "expected at least 36 expressions.*study.blendshapes and study.animation_frames"),
        (
            ["study=alm_shapes", "study.shapes=4", "study.expressions=2", "study.counts=[2,4]"],
            "method alm cannot serve",
        ),
        (["study=alm_leave_out"], "expected at least 20 expressions.*study.shapes"),
    ],
)
def test_what_a_folder_of_meshes_cannot_do_is_refused_with_the_mend(
    bare: list[str], settings: list[str], message: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInput, match=message):
        run(composed("run", [*settings, *bare]), tmp_path, quiet())
    assert not list(tmp_path.rglob("*.parquet"))
