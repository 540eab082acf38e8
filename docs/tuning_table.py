"""Prints the figures of docs/methods/tuning.md: `python docs/tuning_table.py [jobs]`, about 5 minutes on 2 cores."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import permutations, product

import joblib
import numpy as np

from experiments.catalogue import make_method
from experiments.protocol import draw
from retarget.types import Examples, FloatArray, IntArray, Pair, Prepared
from synth_data.makehuman.dataset import MakeHuman

DATA = MakeHuman(identities=4, first_seed=1000)
DRAWS, TEST_EXPRESSIONS, COUNTS = 5, 5, (5, 15, 30)
TUNED = ("lbs", "plbs", "lbs_residual", "plbs_residual")
COMPARED = ("delta", "gradient_transfer", "sumner_popovic", "lbs_paper", "plbs_paper")
CONTROLS = ("lbs_residual", "plbs_residual")  # also with the other deformation transfer, at the configured lambda
LAMBDAS = tuple(float(f"{value:.1e}") for value in np.logspace(-8, 0, 13))  # mm^2 per vertex
WITHIN = 1.01  # of the smallest error: values that can hardly be told apart

Errors = dict[tuple[str, float | None], FloatArray]  # (3,) mm for `COUNTS`, by method and lambda


@dataclass(frozen=True)
class Task:
    """One ordered pair of identities and all their frames (N, n, 3) mm."""

    names: tuple[str, str]
    pair: Pair
    source: FloatArray
    target: FloatArray
    head: IntArray

    def errors(self) -> Errors:
        """Mean vertex error on the head over draws and test expressions."""
        found: Errors = {("neutral", None): self._neutral()}
        for name in COMPARED:
            found[name, None] = self._error(make_method(name).prepare(self.pair))
        for name in CONTROLS:
            found[name, None] = self._error(make_method(name, deformation_transfer="uniform").prepare(self.pair))
        for name, value in product(TUNED, LAMBDAS):
            found[name, value] = self._error(make_method(name, lambda_reg=value).prepare(self.pair))
        return found

    def _error(self, prepared: Prepared) -> FloatArray:
        errors = np.zeros((DRAWS, len(COUNTS)))
        for number, (i, count) in product(range(DRAWS), enumerate(COUNTS)):
            drawn = draw(*self.names, number, len(self.source), TEST_EXPRESSIONS, seed=0)
            test, chosen = list(drawn.test), list(drawn.examples(count))
            fitted = prepared.fit(Examples(self.target[chosen], self.source[chosen]), self.source)
            errors[number, i] = self._distance(fitted(self.source[test]).frames, self.target[test])
        return errors.mean(axis=0)

    def _neutral(self) -> FloatArray:
        drawn = (draw(*self.names, number, len(self.source), TEST_EXPRESSIONS, seed=0) for number in range(DRAWS))
        errors = [self._distance(self.pair.target_neutral, self.target[list(d.test)]) for d in drawn]
        return np.full(len(COUNTS), np.mean(errors))

    def _distance(self, frames: FloatArray, truth: FloatArray) -> float:
        return float(np.linalg.norm(frames - truth, axis=-1)[:, self.head].mean())


def tasks() -> Iterator[Task]:
    """The 12 ordered pairs of the tuning identities."""
    data = DATA.load()
    frames = {name: data.frames(name, range(DATA.expressions)) for name in data.identities}
    for a, b in permutations(data.identities, 2):
        pair = Pair(data.faces, data.neutral(a), data.neutral(b), data.regions)
        yield Task((a, b), pair, frames[a], frames[b], data.regions.vertices["head"])


def chosen(errors: Mapping[float, FloatArray]) -> float:
    """The largest lambda whose error, averaged over the counts, is within 1 % of the smallest."""
    mean = {value: error.mean() for value, error in errors.items()}
    return max(value for value, error in mean.items() if error <= WITHIN * min(mean.values()))


def main(jobs: int) -> None:
    found = joblib.Parallel(n_jobs=jobs)(joblib.delayed(Task.errors)(task) for task in tasks())
    errors: Errors = {key: np.mean([of_pair[key] for of_pair in found], axis=0) for key in found[0]}
    curves = {name: {value: errors[name, value] for value in LAMBDAS} for name in TUNED}
    best = {name: chosen(curve) for name, curve in curves.items()}
    print("| $\\lambda_{reg}$ |", " | ".join(f"`{name}`" for name in TUNED), "|")
    print("| --- |" + " --- |" * len(TUNED))
    for value in LAMBDAS:
        cells = [_cell(errors[name, value]) for name in TUNED]
        bold = [f"**{cell}**" if best[name] == value else cell for name, cell in zip(TUNED, cells, strict=True)]
        print(f"| {_scientific(value)} |", " | ".join(bold), "|")
    print("\n| for comparison | error (mm) |\n| --- | --- |")
    for name in ("neutral", *COMPARED, *CONTROLS):
        error = errors[name, None]
        label = f"`{name}` with `uniform`" if name in CONTROLS else f"`{name}`"
        print(f"| {label} | {f'{error[0]:.3f}' if np.ptp(error) == 0 else _cell(error)} |")
    print("\n| | chosen | error, averaged over the counts | smallest error | at |\n| --- | --- | --- | --- | --- |")
    for name, curve in curves.items():
        lowest = min(curve, key=lambda value: curve[value].mean())
        row = (_scientific(best[name]), f"{curve[best[name]].mean():.4f}", f"{curve[lowest].mean():.4f}")
        print(f"| `{name}` |", " | ".join(row), f"| {_scientific(lowest)} |")


def _cell(error: FloatArray) -> str:
    return " / ".join(f"{value:.3f}" for value in error)


def _scientific(value: float) -> str:
    return np.format_float_scientific(value, precision=1, unique=False, exp_digits=1)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else -1)
