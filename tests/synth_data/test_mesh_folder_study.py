"""A study on a user's folder from the command line: heads that move, in cm, with the regions of their topology."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from experiments.metrics.signed_error import SignedError
from experiments.metrics.vertex_l2 import VertexL2
from experiments.plan import _measurable
from retarget.io.mesh import write_obj
from retarget.io.regions import write_regions
from retarget.types import FloatArray, Regions
from synth_data.dataset import Dataset
from synth_data.makehuman.dataset import MakeHuman

pytestmark = pytest.mark.xdist_group("cli")
EXPRESSIONS = 20


@pytest.fixture(scope="module")
def performed() -> Dataset:
    return MakeHuman(identities=2, expressions=EXPRESSIONS, truth="personal_blendshapes", weights="sparse").load()


@pytest.fixture(scope="module")
def folder(performed: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Their frames as a scanner would give them: the head turns and shifts from one to the next."""
    root = tmp_path_factory.mktemp("user") / "my scans [2024]"
    rng = np.random.default_rng(3)
    for identity in performed.identities:
        person = root / identity.replace("-", " #")
        write_obj(person / "Neutral.obj", performed.neutral(identity) / 10, performed.faces)
        frames = performed.frames(identity, range(EXPRESSIONS))
        for name, frame in zip(performed.expressions, frames, strict=True):
            turn = Rotation.from_rotvec(rng.normal(size=3) * 0.02).as_matrix()
            write_obj(person / f"{name}.obj", (frame @ turn.T + rng.normal(size=3)) / 10, performed.faces)
    write_regions(root / "regions.json", performed.regions)
    return root


def call(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "experiments", "run", "dataset=mesh_folder", f"dataset.root='{folder}'"]
    command += ["dataset.units=cm", f"dataset.cache='{folder.parent / 'cache'}'", "method=[delta]", "backend=serial"]
    command += [f"paths.results='{folder.parent / 'results'}'", f"dataset.regions='{folder}'", "report=false"]
    here = os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])}
    return subprocess.run(
        [*command, *arguments], cwd=folder.parent, env=here, capture_output=True, text=True, timeout=300
    )


def test_a_study_runs_and_measures_what_the_people_perform(folder: Path, performed: Dataset) -> None:
    refused = call(folder)  # the default study wants 30 examples
    assert refused.returncode == 1
    assert "'study.n_examples=[5,15]'" in refused.stderr
    assert "Neutral" in refused.stdout
    assert "person #000" in refused.stdout

    done = call(folder, "study.n_examples=[5]", "study.draws=2", "study.figures.pairs=0")
    assert done.returncode == 0, done.stderr
    metrics = pd.read_parquet(folder.parent / "results" / "quantitative" / "metrics.parquet")
    assert set(metrics["dataset"]) == {"mesh_folder:my scans [2024]"}
    assert set(metrics["truth"]) == {"scans"}
    rows = metrics[(metrics["method"] == "delta") & (metrics["metric"] == "vertex_l2_mean")]
    rows = rows[rows["region"] == "lips"]
    assert len(rows) == 2 * 2 * 5
    for row in rows.itertuples():
        source, target = (motion(performed, str(name), str(row.expression)) for name in (row.source, row.target))
        assert row.value == pytest.approx(np.linalg.norm(source - target, axis=1).mean(), abs=1e-3)


def motion(performed: Dataset, identity: str, expression: str) -> FloatArray:
    """(m, 3) mm of the lips against the neutral, aligned on the cranium by scipy, in the first person's axes."""
    name, cranium = identity.replace(" #", "-"), performed.regions.vertices["cranium"]

    def turned(moving: FloatArray, fixed: FloatArray) -> tuple[FloatArray, FloatArray]:
        centre = moving[cranium].mean(axis=0)
        turn, _ = Rotation.align_vectors(fixed[cranium] - fixed[cranium].mean(axis=0), moving[cranium] - centre)
        return turn.as_matrix(), centre

    rest, first = performed.neutral(name), performed.neutral(performed.identities[0])
    frame = performed.frames(name, [performed.expressions.index(expression)])[0]
    turn, centre = turned(frame, rest)
    still = (frame - centre) @ turn.T + rest[cranium].mean(axis=0)
    moves: FloatArray = (still - rest)[performed.regions.vertices["lips"]] @ turned(rest, first)[0].T
    return moves


def test_metrics_measure_the_regions_that_a_topology_names() -> None:
    regions = Regions({"head": np.arange(9), "lips": np.arange(3)})
    metrics = {
        "vertex_l2": (VertexL2(["mean"], ["head", "nose", "lips", "jaw"]), {"regions": "as configured"}),
        "signed_error": (SignedError(["eyes"]), {}),
        "misspelt": (SignedError(["haed"]), {}),
    }
    measurable, left_out = _measurable(metrics, regions)
    assert measurable["vertex_l2"][0] == VertexL2(["mean"], ["head", "lips"])
    assert measurable["vertex_l2"][1] == {"regions": "as configured"}
    assert measurable["misspelt"][0] == SignedError(["haed"])  # which refuses it, with the names that there are
    assert set(left_out) == {"vertex_l2 in nose, jaw", "signed_error"}
    assert left_out["signed_error"] == "the regions of this dataset name no vertices eyes"
