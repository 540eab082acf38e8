from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from omegaconf import OmegaConf
from rich.console import Console

from baselines.delta_transfer import DeltaTransfer
from experiments import run as runner
from experiments import study as study_module
from experiments.catalogue import composed
from experiments.gate import GATES, Gate, compare, gate, propose, read_gates, write_gates
from retarget.check import InvalidInput
from retarget.types import Examples, FloatArray, IntArray, Pair, Prepared, RetargetResult
from tests.experiments.toy import toy

GATE = Gate("plbs", 5, "vertex_l2_mean", "head", 0.5, 0.01, "mm", "lower", "because", "study=ci")


def metrics(value: float = 0.5) -> pd.DataFrame:
    rows = [
        ("plbs", 5, "vertex_l2_mean", "head", value - 0.1, "mm"),
        ("plbs", 5, "vertex_l2_mean", "head", value + 0.1, "mm"),
        ("plbs", 5, "vertex_l2_max", "head", 9.0, "mm"),
        ("plbs", 5, "signed_error_x", "head", 0.001, "mm"),
    ]
    return pd.DataFrame(rows, columns=["method", "n_examples", "metric", "region", "value", "unit"])


@pytest.mark.parametrize(("value", "passed"), [(0.5, True), (0.509, True), (0.511, False), (0.489, False)])
def test_a_gate_holds_from_both_sides(value: float, passed: bool) -> None:
    assert compare(metrics(value), [GATE])[0].passed is passed


@pytest.mark.parametrize("by", [0.05, -0.05])
def test_every_gate_under_version_control_fails_when_its_value_moves_by_a_twentieth_of_a_millimetre(by: float) -> None:
    gates = [entry for entry in read_gates(GATES / "ci.yaml") if entry.unit == "mm"]
    values = pd.DataFrame([vars(entry) for entry in gates])
    assert all(verdict.passed for verdict in compare(values, gates))
    assert not any(verdict.passed for verdict in compare(values.assign(value=values["value"] + by), gates))
    one = values.assign(value=values["value"] + by * (values.index == 7))
    assert [verdict.gate for verdict in compare(one, gates) if not verdict.passed] == [gates[7]]


@dataclass(frozen=True)
class Offset(DeltaTransfer):
    """Delta transfer that puts every vertex of a region (all without one) in the wrong place."""

    by: tuple[float, float, float] = (0.0, 0.0, 0.0)  # mm
    region: str = "head"

    def prepare(self, pair: Pair) -> Prepared:
        return Moved(super().prepare(pair), pair.regions.vertices[self.region], self.by)


@dataclass(frozen=True)
class Moved:
    inner: Any
    vertices: IntArray
    by: tuple[float, float, float]

    def fit(self, examples: Examples, animation: FloatArray) -> Moved:
        return replace(self, inner=self.inner.fit(examples, animation))

    def __call__(self, source_frames: FloatArray, edits: Any = None) -> RetargetResult:
        result = self.inner(source_frames)
        frames = result.frames.copy()
        frames[:, self.vertices] += self.by
        return replace(result, frames=frames)


def study(folder: Path, method: Offset) -> pd.DataFrame:
    """Metrics of a toy study of one method, as `gate` reads them."""
    settings = ["study=ci", "method=[delta]", "metric=[vertex_l2,signed_error]", "report=false", "backend=serial",
                "study.n_examples=[5]", "study.references=[]", "study.figures.pairs=0",
                "metric.vertex_l2.regions=[head]", "metric.signed_error.regions=[head,lips]"]  # fmt: skip
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "_dataset", lambda config, console: toy(2, subdivisions=2))
        patch.setattr(study_module, "_method", lambda name, settings: method)
        runner.run(composed("run", settings), folder, Console(file=io.StringIO()))
    return pd.read_parquet(folder / "metrics.parquet")


def test_the_gate_fails_when_the_vertices_of_a_method_move_by_a_twentieth_of_a_millimetre(tmp_path: Path) -> None:
    proposal = propose(study(tmp_path / "before", Offset()), "here")
    assert all(verdict.passed for verdict in compare(study(tmp_path / "again", Offset()), proposal))
    even = 0.05 / np.sqrt(3)
    for i, (by, region) in enumerate([((0.05, 0, 0), "head"), ((0, -0.05, 0), "lips"), ((even, even, even), "head")]):
        moved = compare(study(tmp_path / str(i), Offset(by=by, region=region)), proposal)
        failed = {verdict.gate.metric for verdict in moved if not verdict.passed}
        assert failed == {f"signed_error_{axis}" for axis, step in zip("xyz", by, strict=True) if step}
        assert "vertex_l2_mean" not in failed  # which a constant offset hardly moves: signed errors catch it


def test_a_row_without_an_answer_fails_its_gate() -> None:
    assert not compare(metrics(), [replace(GATE, method="lbs")])[0].passed
    assert not compare(metrics().assign(value=float("nan")), [GATE])[0].passed


def test_proposed_gates_hold_on_the_study_that_they_come_from_and_watch_the_offset() -> None:
    proposal = propose(metrics(), "here")
    assert all(verdict.passed for verdict in compare(metrics(), proposal))
    assert {entry.metric for entry in proposal} == {"vertex_l2_mean", "signed_error_x"}
    offset = metrics().assign(value=lambda rows: rows["value"] + 0.011 * (rows["metric"] == "signed_error_x"))
    assert [v.gate.metric for v in compare(offset, proposal) if not v.passed] == ["signed_error_x"]


def test_the_command_prints_a_table_and_tells_whether_all_hold(tmp_path: Path) -> None:
    file = tmp_path / "gates.yaml"
    metrics().to_parquet(tmp_path / "metrics.parquet")
    out = io.StringIO()
    proposing = OmegaConf.create({"study": {"name": "ci"}, "gates": None, "propose": str(file)})
    checking = OmegaConf.create({"study": {"name": "ci"}, "gates": str(file), "propose": None})
    assert gate(tmp_path, proposing, Console(file=out))
    assert gate(tmp_path, checking, Console(file=out, width=150))
    assert "2 gates hold (1 on signed errors are not listed), 0 fail" in out.getvalue()
    metrics(0.6).to_parquet(tmp_path / "metrics.parquet")
    assert not gate(tmp_path, checking, Console(file=out, width=150))
    assert "FAIL" in out.getvalue()


def test_gates_come_back_as_they_were_written(tmp_path: Path) -> None:
    gates = [GATE, replace(GATE, metric="signed_error_x", value=-0.001, direction="zero"), replace(GATE, n_examples=15)]
    write_gates(tmp_path / "gates.yaml", gates)
    assert sorted(read_gates(tmp_path / "gates.yaml"), key=str) == sorted(gates, key=str)


def test_missing_studies_and_odd_files_are_refused(tmp_path: Path) -> None:
    config = OmegaConf.create({"study": {"name": "ci"}, "gates": None, "propose": None})
    with pytest.raises(InvalidInput, match="no finished study there"):
        gate(tmp_path / "ci", config, Console())
    with pytest.raises(InvalidInput, match="no gates file"):
        read_gates(tmp_path / "gates.yaml")
    (tmp_path / "gates.yaml").write_text("- {unit: mm, gates: [[plbs, 5]]}")
    with pytest.raises(InvalidInput, match="expected groups with unit, direction"):
        read_gates(tmp_path / "gates.yaml")
    (tmp_path / "metrics.parquet").write_bytes(b"PAR1")
    with pytest.raises(InvalidInput, match=r"metrics.parquet: cannot be read as a table"):
        gate(tmp_path, config, Console())
    pd.DataFrame({"value": [1.0]}).to_parquet(tmp_path / "metrics.parquet")
    with pytest.raises(InvalidInput, match=r"metrics.parquet: expected the column method"):
        gate(tmp_path, config, Console())


def _gates(direction: str = "lower", reason: str = "measured", row: str = "1.0, 0.1") -> str:
    shared = f"unit: mm, direction: {direction}, reason: {reason}, origin: here"
    return f"- {{{shared}, gates: [[plbs, 5, vertex_l2_mean, head, {row}]]}}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[]", "at least one gate"),
        ("- {unit: mm, direction: lower, reason: r, origin: o, gates: []}", "at least one gate"),
        ("{unit: [", "expected groups with unit, direction"),
        ("5", "expected groups with unit, direction"),
        ("", "expected groups with unit, direction"),
        (_gates(row="x, 0.1"), "value: expected a number, got 'x' of plbs"),
        (_gates(row=".nan, 0.1"), "value: expected a number, got nan"),
        (_gates(row="1.0, .inf"), "tolerance: expected a number above 0, got inf"),
        (_gates(row="1.0, -1"), "tolerance: expected a number above 0, got -1"),
        (_gates(direction="sideways"), "direction: expected one of lower, higher, zero, got 'sideways'"),
        (_gates(reason=""), "reason: expected why"),
    ],
)
def test_a_file_of_gates_that_hold_nothing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "gates.yaml").write_text(text)
    with pytest.raises(InvalidInput, match=message):
        read_gates(tmp_path / "gates.yaml")


def test_the_gates_under_version_control_cover_every_method_of_the_study() -> None:
    gates = read_gates(GATES / "ci.yaml")
    assert {entry.n_examples for entry in gates} == {5, 15, 30}
    assert {"delta", "sumner_popovic", "gradient_transfer", "lbs", "plbs", "lbs_residual", "plbs_residual"} <= {
        entry.method for entry in gates
    }
    assert all(entry.tolerance > 0 and entry.reason and entry.origin for entry in gates)
    assert all(entry.tolerance <= 0.01 for entry in gates if entry.metric.startswith("signed_error"))
