"""Twenty shapes, sixteen build and four are held out: section 4.2 and Fig. 8 of Chandran et al. 2022."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console

from experiments.alm_study import AlmStudy, Case, cases, save, summary_of_errors
from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker
from experiments.progress import print_line, progress
from reports.leave_out_sheet import Shown, write_leave_out_sheet
from retarget.check import InvalidInput, check_whole
from retarget.types import Examples, FloatArray, Prepared, RetargetProblem
from synth_data.dataset import Dataset


@dataclass(frozen=True, kw_only=True)
class LeaveOutStudy(AlmStudy):
    """``conf/study/alm_leave_out.yaml``. expressions: how many of the shapes each fold holds out."""

    folds: int
    shown: int

    def check(self) -> None:
        check_whole("study.folds", self.folds, 1)
        check_whole("study.shown", self.shown, 0)
        if self.folds * self.expressions > self.shapes or self.expressions >= self.shapes:
            raise InvalidInput(
                f"study.folds: expected folds of {self.expressions} different shapes each, of {self.shapes}, "
                f"got {self.folds} folds."
            )


def leave_out(
    study: LeaveOutStudy,
    makers: Sequence[MethodMaker],
    dataset: Dataset,
    threads: int,
    folder: Path,
    console: Console,
) -> None:
    """Run the study and write ``records.csv``, ``summary.csv`` and ``alm_leave_out.pdf``.

    The summary compares the first method that serves the data with each of the others. Raises InvalidInput where none
    does.
    """
    rows: list[dict[str, object]] = []
    shown: list[Shown] = []
    with limited_threads(threads), progress(console, "pairs", study.pairs) as advance:
        # No expression is tested besides the shapes; one is drawn all the same where there is one to spare.
        for case in cases(replace(study, expressions=int(len(dataset.expressions) > study.shapes)), dataset):
            methods = {maker.name: maker().prepare(case.pair) for maker in _serving(makers, case.problem, console)}
            for fold in range(study.folds):
                held, frames = folded(study, case, methods, fold)
                errors = {name: held.error(found, held.truth) for name, found in frames.items()}
                rows += [
                    {
                        "source": case.source,
                        "target": case.target,
                        "fold": fold,
                        "shape": shape,
                        "method": name,
                        "mm": error,
                    }
                    for name, values in errors.items()
                    for shape, error in zip(held.tests, values, strict=True)
                ]
                if fold == 0 and len(shown) < study.shown:
                    shown.append(_liveliest(held, frames, errors))
            advance(1)
    records = pd.DataFrame(rows)
    summary = summary_of_errors(records, str(records["method"].iloc[0]))
    with tempfile.TemporaryDirectory(prefix="sheet-") as work:
        write_leave_out_sheet(folder / f"{study.name}.pdf", study.title, study.description, shown, summary, Path(work))
    save(study, records, summary, folder, console)


def _serving(makers: Sequence[MethodMaker], problem: RetargetProblem, console: Console) -> list[MethodMaker]:
    """The methods that serve a problem; of the others a line says why they do not. Raises InvalidInput for none."""
    refusals = {maker.name: maker().unsupported(problem) for maker in makers}
    for name, reason in refusals.items():
        if reason:
            print_line(f"  left out: {name}, {reason}", console)
    if all(refusals.values()):
        raise InvalidInput("method: none of those chosen serves this dataset; choose others with 'method=[NAME,NAME]'.")
    return [maker for maker in makers if not refusals[maker.name]]


def folded(
    study: LeaveOutStudy, case: Case, methods: Mapping[str, Prepared], fold: int
) -> tuple[Case, Mapping[str, FloatArray]]:
    """The held-out shapes of a fold as tests, and what every method makes of them; all know the same other shapes."""
    assert case.shapes.source is not None
    order = np.random.default_rng(study.seed).permutation(case.shapes.count)
    out = np.sort(order[fold * study.expressions : (fold + 1) * study.expressions])
    build = np.setdiff1d(np.arange(case.shapes.count), out)
    known = Examples(case.shapes.target[build], case.shapes.source[build])
    names = tuple(case.names[i] for i in out)
    true = case.true_shapes
    held = replace(
        case, shapes=known, true_shapes=true[build], tests=names, frames=case.shapes.source[out], truth=true[out]
    )
    found = {name: prepared.fit(known, case.span)(held.frames).frames for name, prepared in methods.items()}
    return held, found


def _liveliest(held: Case, frames: Mapping[str, FloatArray], errors: Mapping[str, FloatArray]) -> Shown:
    """The held-out shape that moves most."""
    i = int(np.argmax(np.linalg.norm(held.truth - held.pair.target_neutral, axis=2).mean(axis=1)))
    return Shown(
        f"{held.tests[i]}, {held.source} to {held.target}",
        held.pair,
        held.frames[i],
        held.truth[i],
        {name: found[i] for name, found in frames.items()},
        {name: float(values[i]) for name, values in errors.items()},
    )
