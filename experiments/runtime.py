"""How fast the simulation is: two inverse and two forward simulations for each expression (section 4.1 of the paper).

For each expression of an animation, one at a time and in its order: adt of the part that patchwise blendshapes miss
(Algorithm 1), then anacon of the sum (eq. 19).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from rich.console import Console

from experiments.backend import limited_threads
from experiments.catalogue import MethodMaker, make_method
from experiments.collision import chosen_pairs
from experiments.memory import peak_memory_mb
from experiments.progress import Advance, print_path, progress
from experiments.study import check_settings
from reports.terminal import print_runtime
from retarget.anatomical_transfer import former
from retarget.anatomy.fit import fit_head
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.character import forget
from retarget.check import InvalidInput, check_whole
from retarget.io.files import write_whole
from retarget.simulation.bones import size_ratio
from retarget.simulation.characteristics import FacialCharacteristics
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, Pair, RetargetProblem, Status
from synth_data.dataset import Dataset

FRAMES_LEAST = 50  # fewer give no median to speak of
STAGES = ("adt_inverse", "adt_forward", "anacon_inverse", "anacon_forward")


@dataclass(frozen=True)
class RuntimeStudy:
    """``conf/study/runtime.yaml``."""

    name: str
    title: str
    description: str
    seed: int
    template: str
    animation_frames: int
    frames_per_expression: int
    blendshapes: int
    surfaces: tuple[str, ...]

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> RuntimeStudy:
        """Raises InvalidInput for a value that the study cannot have."""
        check_settings("study", config, RuntimeStudy)
        study = RuntimeStudy(**{**config, "surfaces": tuple(config["surfaces"])})
        for name, value, least in (
            ("animation_frames", study.animation_frames, FRAMES_LEAST),
            ("frames_per_expression", study.frames_per_expression, 1),
            ("blendshapes", study.blendshapes, 1),
        ):
            check_whole(f"study.{name}", value, least)
        choose("study.template", study.template, ("coarse", "paper"))
        for surface in study.surfaces:
            choose("study.surfaces", surface, ("soft", "hard"))
        return study


@dataclass(frozen=True)
class Performance:
    """What is retargeted: an animation, and what patchwise blendshapes of the examples make of it."""

    pair: Pair
    examples: Examples
    frames: FloatArray  # (t, n, 3) mm, S_i
    missing: FloatArray  # (t, n, 3) mm, S_i^M, eq. (4)
    blended: FloatArray  # (t, n, 3) mm, T_i^P


@dataclass(frozen=True)
class Engine:
    """The simulations that one pair needs, set up."""

    source: InverseSimulation
    target: InverseSimulation
    forward: ForwardSimulation
    characteristics: FacialCharacteristics
    scale: float  # BB(T) / BB(S)


def measure(
    study: RuntimeStudy, make: MethodMaker, dataset: Dataset, threads: int, folder: Path, console: Console
) -> None:
    """Run the study and write ``frames.csv`` and ``summary.csv``."""
    performance = perform(study, dataset)
    make.serving(RetargetProblem.of(performance.pair, performance.examples, performance.frames))
    template = load_template(dataset.faces, dataset.regions, study.template)
    cases = [(surface, collisions) for surface in study.surfaces for collisions in (False, True)]
    with limited_threads(threads):
        started = time.perf_counter()
        console.print("fitting two heads")
        source, target = (
            fit_head(template, v) for v in (performance.pair.source_neutral, performance.pair.target_neutral)
        )
        fit_seconds = time.perf_counter() - started
        console.print("compiling, up to two minutes where it was never done")
        warm_up(study, performance, source, target)
        tables = []
        with progress(console, "expressions", (len(cases) + 2) * study.animation_frames) as advance:
            for surface, collisions in cases:
                started = time.perf_counter()
                engine = set_up(performance.pair, source, target, surface, collisions)
                seconds = time.perf_counter() - started
                table = stream(engine, performance, advance)
                tables.append(table.assign(surface=surface, collisions=collisions, setup_seconds=seconds))
            memory = peak_memory_mb()
            del engine
            console.print("the whole method, from neutrals to frames")
            whole = pd.concat(
                [retarget(study, make, performance, collisions, advance) for collisions in (False, True)],
                ignore_index=True,
            )
    frames = pd.concat(tables, ignore_index=True)
    summary = summarise(frames).assign(
        **summarise_method(whole),
        template=study.template,
        skin_vertices=template.embedding.shape[0],
        tet_vertices=len(template.vertices),
        tets=len(template.tets),
        threads=threads,
        fit_seconds=round(fit_seconds, 2),
        peak_memory_mb=round(memory),
        anacondar_peak_memory_mb=round(peak_memory_mb()),
    )
    write_whole(folder / "frames.csv", lambda temporary: frames.to_csv(temporary, index=False))
    write_whole(folder / "method.csv", lambda temporary: whole.to_csv(temporary, index=False))
    write_whole(folder / "summary.csv", lambda temporary: summary.to_csv(temporary, index=False))
    print_runtime(summary, console)
    print_path(folder / "summary.csv", console)


def perform(study: RuntimeStudy, dataset: Dataset) -> Performance:
    """The first identity performs, the second answers: an animation that moves smoothly through drawn expressions."""
    [(source, target)] = chosen_pairs(dataset.identities, 1)
    rng = np.random.default_rng(np.random.SeedSequence([study.seed]))
    stops = -(-study.animation_frames // study.frames_per_expression)
    if study.blendshapes + stops > len(dataset.expressions):
        raise InvalidInput(
            f"dataset: expected at least {study.blendshapes + stops} expressions ({study.blendshapes} examples and "
            f"{stops} to pass), got {len(dataset.expressions)}; ask for fewer with study.blendshapes and "
            "study.animation_frames."
        )
    order = rng.permutation(len(dataset.expressions))
    examples, passed = order[: study.blendshapes], order[study.blendshapes :][:stops]
    pair = dataset.scanned_pair(source, target)
    keys = np.concatenate([pair.source_neutral[None], dataset.scanned(source, passed.tolist())])
    at = np.arange(1, study.animation_frames + 1) / study.frames_per_expression
    before = np.minimum(at.astype(int), stops - 1)
    share = at - before
    share = (share * share * (3 - 2 * share))[:, None, None]  # eases in and out
    frames = (1 - share) * keys[before] + share * keys[before + 1]
    plbs = make_method("plbs").prepare(pair)
    shapes = Examples(dataset.scanned(target, examples.tolist()), dataset.scanned(source, examples.tolist()))
    result = plbs.fit(shapes, frames)(frames)
    missing = pair.source_neutral + frames - result.parts["source_reconstruction"]  # eq. (4)
    return Performance(pair, shapes, frames, missing, result.frames)


def set_up(pair: Pair, source: Head, target: Head, surface: str, collisions: bool) -> Engine:
    """Factors, compliance and all else that serves every expression of the pair."""
    settings = InverseSettings(surface=surface)  # type: ignore[arg-type]  # checked by RuntimeStudy
    return Engine(
        InverseSimulation(source, settings),
        InverseSimulation(target, settings),
        ForwardSimulation(target, ForwardSettings(collisions=collisions)),
        FacialCharacteristics(pair),
        size_ratio(pair.source_neutral, pair.target_neutral),
    )


def stream(engine: Engine, performance: Performance, advance: Advance = lambda count: None) -> pd.DataFrame:
    """One row for each expression: seconds by stage, iterations, lip depths in mm, whether all solves converged."""
    rows = []
    neutral = performance.pair.target_neutral
    adt, anacon = (former(simulation, streaming=True) for simulation in (engine.source, engine.target))
    for i, expression in enumerate(performance.frames):
        clock = [time.perf_counter()]
        source = adt(performance.missing[i], None)
        clock.append(time.perf_counter())
        wanted = engine.characteristics(performance.missing[i])
        missing = engine.forward(source.gradients, source.bones, engine.scale, wanted)  # T_i^M, eq. (5)
        clock.append(time.perf_counter())
        target = anacon(performance.blended[i] + missing.skin - neutral, missing)
        clock.append(time.perf_counter())
        wanted = engine.characteristics(expression)
        final = engine.forward(target.gradients, target.bones, 1.0, wanted)  # T_i, eq. (19)
        clock.append(time.perf_counter())
        states = source, missing, target, final
        rows.append(
            {
                "frame": i,
                **dict(zip(STAGES, np.diff(clock), strict=True)),
                "seconds": clock[-1] - clock[0],
                "adt_iterations": source.info.iterations,
                "anacon_iterations": target.info.iterations,
                "lip_depth_before": final.lips.before,
                "lip_depth_after": final.lips.after,
                "lip_runs": missing.lips.rounds + final.lips.rounds,
                "converged": all(state.info.status is Status.CONVERGED for state in states),
            }
        )
        advance(1)
    return pd.DataFrame(rows)


def retarget(
    study: RuntimeStudy,
    make: MethodMaker,
    performance: Performance,
    collisions: bool,
    advance: Advance = lambda count: None,
) -> pd.DataFrame:
    """AnaConDaR from neutrals and examples on, as a user calls it: one row for each expression of the animation."""
    forget()
    started = time.perf_counter()
    method = make(template=study.template, streaming=True, collisions=collisions)
    fitted = method.prepare(performance.pair).fit(performance.examples, performance.frames)
    setup = time.perf_counter() - started
    rows, started = [], time.perf_counter()
    for one in fitted.stream(iter(performance.frames)):  # type: ignore[attr-defined]
        now = time.perf_counter()
        rows.append({"seconds": now - started, "status": str(one.info.status), "iterations": one.info.iterations})
        advance(1)
        started = time.perf_counter()
    return pd.DataFrame(rows).assign(collisions=collisions, setup_seconds=setup)


def summarise_method(whole: pd.DataFrame) -> dict[str, float]:
    """Rates of the whole method, one over the median of the expressions' seconds, and its set-up."""
    plain, resolved = whole[~whole["collisions"]], whole[whole["collisions"]]
    return {
        "anacondar_per_s": round(1 / plain["seconds"].median(), 2),
        "anacondar_per_s_collisions": round(1 / resolved["seconds"].median(), 2),
        "anacondar_setup_seconds": round(plain["setup_seconds"].iloc[0], 2),
        "anacondar_not_converged": int((whole["status"] != Status.CONVERGED).sum()),
    }


def warm_up(study: RuntimeStudy, performance: Performance, source: Head, target: Head) -> None:
    """Two expressions of each kind, so that no time of a compiler is measured."""
    short = Performance(
        performance.pair,
        performance.examples,
        *(v[:2] for v in (performance.frames, performance.missing, performance.blended)),
    )
    for surface in study.surfaces:
        stream(set_up(performance.pair, source, target, surface, True), short)


def summarise(frames: pd.DataFrame) -> pd.DataFrame:
    """One row for each form of the surface target; rates are one over the median of the expressions' seconds."""
    rows = []
    for surface, both in frames.groupby("surface", sort=False):
        plain, resolved = both[~both["collisions"]], both[both["collisions"]]
        rows.append(
            {
                "surface": surface,
                "expressions": len(plain),
                "expressions_per_s": round(1 / plain["seconds"].median(), 2),
                "expressions_per_s_collisions": round(1 / resolved["seconds"].median(), 2),
                "slowest_seconds": round(both["seconds"].max(), 3),
                "setup_seconds": round(resolved["setup_seconds"].iloc[0], 2),
                **{f"{stage}_ms": round(1e3 * resolved[stage].median(), 1) for stage in STAGES},
                "iterations": float(both[["adt_iterations", "anacon_iterations"]].median().mean()),
                "expressions_with_contacts": int((resolved["lip_depth_before"] > 0).sum()),
                "lip_depth_before_max": round(resolved["lip_depth_before"].max(), 3),
                "lip_depth_after_max": round(resolved["lip_depth_after"].max(), 3),
                "not_converged": int((~both["converged"]).sum()),
            }
        )
    return pd.DataFrame(rows)
