"""Lip collisions before and after they are resolved (Fig. 14 of the paper).

Every expression is retargeted twice, without and with the resolution of collisions; those that cross without it are
the cases.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console
from scipy.spatial import cKDTree

from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker
from experiments.lip_depth import LipDepth
from experiments.progress import Advance, print_path, progress
from experiments.protocol import draw
from experiments.study import check_settings
from reports.collision_sheet import Case, write_collision_sheet
from reports.terminal import print_collisions
from retarget.check import InvalidInput, check_whole
from retarget.io.files import write_whole
from retarget.types import Examples, FloatArray, RetargetProblem, Status
from synth_data.dataset import Dataset

DISTANCES = (0.0, 2.0, 5.0, 10.0, 20.0, 30.0, 50.0, 80.0, 120.0)  # mm from the nearest contact
FAR = 30.0  # mm


@dataclass(frozen=True)
class CollisionStudy:
    """``conf/study/collision.yaml``."""

    name: str
    title: str
    description: str
    seed: int
    n_examples: int
    pairs: int
    expressions: int
    depth: float
    shown: int

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> CollisionStudy:
        """Raises InvalidInput for a value that the study cannot have."""
        check_settings("study", config, CollisionStudy)
        study = CollisionStudy(**config)
        for name, least in (("n_examples", 0), ("pairs", 1), ("expressions", 1), ("shown", 1)):
            check_whole(f"study.{name}", getattr(study, name), least)
        if not (isinstance(study.depth, int | float) and 0 < study.depth < np.inf):
            raise InvalidInput(f"study.depth: expected a positive number of mm, got {study.depth!r}.")
        return study


def collide(
    study: CollisionStudy, make: MethodMaker, dataset: Dataset, threads: int, folder: Path, console: Console
) -> None:
    """Run the study and write ``cases.csv``, ``propagation.csv``, ``summary.csv`` and ``collision.pdf``."""
    chosen = chosen_pairs(dataset.identities, study.pairs)
    cases: list[Case] = []
    counts: dict[tuple[str, str], int] = {}
    with limited_threads(threads), progress(console, "expressions", len(chosen) * study.expressions) as advance:
        for source, target in chosen:
            found, counts[source, target] = collisions_of(study, make, dataset, source, target, advance)
            cases += found
    if not cases:
        raise InvalidInput(
            f"study: none of {sum(counts.values())} expressions makes the lips cross by {study.depth} mm; "
            "expected at least one. Take more expressions or pairs, or a smaller study.depth."
        )
    table = pd.DataFrame([case.row for case in cases])
    summary = summarise(table, counts, study.depth)
    spread = pd.concat([propagation(case) for case in cases], ignore_index=True)
    for name, content in (("cases", table), ("propagation", spread), ("summary", summary)):
        write_whole(folder / f"{name}.csv", lambda path, content=content: content.to_csv(path, index=False))  # type: ignore[misc]
    with tempfile.TemporaryDirectory(prefix="sheet-") as work:
        write_collision_sheet(
            folder / "collision.pdf", study.title, study.description, deepest(cases, study.shown), summary, spread,
            Path(work),
        )  # fmt: skip
    print_collisions(summary, console)
    for name in ("cases.csv", "summary.csv", "collision.pdf"):
        print_path(folder / name, console)


def chosen_pairs(identities: Sequence[str], count: int) -> list[tuple[str, str]]:
    """Ordered pairs, neighbours first: every identity is a target before one is a target twice."""
    n = len(identities)
    if n < 2:
        raise InvalidInput(f"dataset.identities: expected at least 2, one performs, the other retargets; got {n}.")
    pairs = [(identities[i], identities[(i + step) % n]) for step in range(1, n) for i in range(n)]
    return pairs[:count]


def collisions_of(
    study: CollisionStudy,
    make: MethodMaker,
    dataset: Dataset,
    source: str,
    target: str,
    advance: Advance = lambda count: None,
) -> tuple[list[Case], int]:
    """The expressions of a pair that make lips cross, and how many were looked at."""
    drawn = draw(source, target, 0, len(dataset.expressions), study.expressions, study.seed)
    pair = dataset.scanned_pair(source, target)
    examples = list(drawn.examples(study.n_examples))
    if len(examples) < study.n_examples:
        raise InvalidInput(
            f"dataset: expected at least {study.expressions + study.n_examples} expressions ({study.expressions} that "
            f"are looked at and {study.n_examples} examples), got {len(dataset.expressions)}; ask for fewer with "
            "study.expressions and study.n_examples."
        )
    span = dataset.scanned(source, examples)
    known = Examples(dataset.scanned(target, examples), span)
    problem = RetargetProblem.of(pair, known, span)
    crossing, resolving = (
        make.serving(problem, collisions=collisions).prepare(pair).fit(known, span) for collisions in (False, True)
    )
    depth = LipDepth(dataset.neutral(target), pair.faces, pair.regions)
    cases = []
    for test in drawn.test:
        frames = dataset.scanned(source, [test])
        before, seconds_before = _timed(crossing, frames)
        depths = depth(before.frames[0])
        if depths.max() > study.depth:
            after, seconds_after = _timed(resolving, frames)
            truth = dataset.frames(target, [test])[0]
            after_depths = depth(after.frames[0])
            contacts = depth.vertices[depths > 0]
            moved = np.linalg.norm(after.frames[0] - before.frames[0], axis=1)
            away, _ = cKDTree(before.frames[0][contacts]).query(before.frames[0])
            row = {
                "source": source,
                "target": target,
                "expression": dataset.expressions[test],
                "depth_before_mm": depths.max(),
                "depth_after_mm": after_depths.max(),
                "depth_truth_mm": depth(truth).max(),
                "inside_before": int((depths > study.depth).sum()),
                "inside_after": int((after_depths > study.depth).sum()),
                "moved_max_mm": moved.max(),
                "moved_far_mm": moved[away > FAR].max(initial=0.0),
                "seconds_before": seconds_before,
                "seconds_after": seconds_after,
                "status": str(after.info[0].status),
                "message": after.info[0].message,
            }
            worst = int(depth.vertices[np.argmax(depths)])
            cases.append(Case(row, pair, before.frames[0], after.frames[0], worst, away))
        advance(1)
    return cases, len(drawn.test)


def _timed(fitted: Any, frames: FloatArray) -> tuple[Any, float]:
    started = time.perf_counter()
    result = fitted(frames)
    return result, time.perf_counter() - started


def propagation(case: Case) -> pd.DataFrame:
    """Displacement of the visible skin by distance from the nearest contact; a row for each range of DISTANCES."""
    moved = np.linalg.norm(case.after - case.before, axis=1)
    seen = case.pair.regions.vertices.get("head", np.arange(len(moved)))
    rows = []
    for low, high in pairwise(DISTANCES):
        within = seen[(case.away[seen] >= low) & (case.away[seen] < high)]
        if len(within):
            rows.append(
                {
                    **{key: case.row[key] for key in ("source", "target", "expression")},
                    "from_mm": low,
                    "to_mm": high,
                    "vertices": len(within),
                    "moved_mean_mm": moved[within].mean(),
                    "moved_max_mm": moved[within].max(),
                }
            )
    return pd.DataFrame(rows)


def summarise(cases: pd.DataFrame, counts: Mapping[tuple[str, str], int], depth: float) -> pd.DataFrame:
    """One row for each pair and one for all: how many expressions cross, how deep before and after, at what cost."""
    rows = []
    pairs = [(f"{source} to {target}", (source, target)) for source, target in counts]
    for name, pair in [*pairs, ("all", None)]:
        mine = cases if pair is None else cases[(cases["source"] == pair[0]) & (cases["target"] == pair[1])]
        rows.append(
            {
                "pair": name,
                "expressions": sum(counts.values()) if pair is None else counts[pair],
                "crossing": len(mine),
                "resolved": int((mine["depth_after_mm"] <= depth).sum()),
                "not_converged": int((mine["status"] != Status.CONVERGED).sum()),
                "depth_before_median_mm": mine["depth_before_mm"].median(),
                "depth_before_max_mm": mine["depth_before_mm"].max(),
                "depth_after_median_mm": mine["depth_after_mm"].median(),
                "depth_after_max_mm": mine["depth_after_mm"].max(),
                "truth_crossing": int((mine["depth_truth_mm"] > depth).sum()),
                "moved_far_max_mm": mine["moved_far_mm"].max(),
                "seconds_before": mine["seconds_before"].median(),
                "seconds_after": mine["seconds_after"].median(),
            }
        )
    return pd.DataFrame(rows)


def deepest(cases: Sequence[Case], count: int) -> list[Case]:
    """The deepest case of each pair, deepest first, then the next of each, and so on: at most `count`."""
    ranked: list[tuple[int, float, int]] = []
    seen: dict[tuple[str, str], int] = {}
    for i in sorted(range(len(cases)), key=lambda i: -cases[i].row["depth_before_mm"]):
        pair = cases[i].row["source"], cases[i].row["target"]
        seen[pair] = seen.get(pair, -1) + 1
        ranked.append((seen[pair], -cases[i].row["depth_before_mm"], i))
    return [cases[i] for _, _, i in sorted(ranked)[:count]]
