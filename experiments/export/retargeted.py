"""What is exported: a source, the truth of a target and what methods make of it, run now or stored by a study."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from experiments.catalogue import MethodMaker
from experiments.export.motion import in_turn, one_by_one, select
from experiments.export.scene import (
    Free,
    Known,
    Scene,
    about_data,
    check_targets,
    chosen_count,
    chosen_take,
    load_dataset,
)
from experiments.progress import print_line, progress
from experiments.protocol import check_counts, draw
from reports.load import FigureCell, load
from retarget.check import InvalidInput, check_whole
from retarget.io.morph_mesh import MorphMesh, flipbook
from retarget.suggest import choose
from retarget.types import Examples, FloatArray, RetargetProblem, Status

AT_ONCE = 10  # frames that a method is given between two signs of progress


def retargeted(config: DictConfig, console: Console, free: Free) -> Scene:
    """Source, truth and the result of each method on one pair; examples are drawn as in a study."""
    makers = _methods(config)
    if config["from"] is not None:
        return _stored(config, [maker.name for maker in makers], free)
    for maker in makers:
        maker()  # raises for settings that cannot be
    for name, least in (("n_examples", 0), ("draw", 0), ("seed", 0), ("test_expressions", 0)):
        check_whole(name, config[name], least)
    take = chosen_take(config, console)

    def check(known: Known) -> tuple[str, str, str]:
        source, target = _pair(config, known.identities)
        check_counts(len(known.expressions), config.test_expressions, config.n_examples, where="")
        check_targets(chosen_count(config, take, known), config)
        stem = f"{'-'.join(maker.name for maker in makers)}-{source}-to-{target}"
        free(stem, 2 + len(makers))
        return source, target, stem

    dataset, (source, target, stem) = load_dataset(config, console, check)
    motion = take or in_turn(dataset, config.frames, config.fps)
    drawn = draw(source, target, config.draw, len(dataset.expressions), config.test_expressions, config.seed)
    examples = drawn.examples(config.n_examples)
    print_line("  performing source and target", console)
    performed, truth = motion.performed(dataset, source), motion.performed(dataset, target)
    pair = dataset.scanned_pair(source, target)
    known = Examples(dataset.scanned(target, examples), dataset.scanned(source, examples))
    problem = RetargetProblem.of(pair, known, dataset.scanned(source, range(len(dataset.expressions))))
    seen = dataset.as_scanned(source, motion.names, performed)

    def character(name: str, identity: str, frames: FloatArray, **about: str) -> MorphMesh:
        about = {"identity": identity, **about}
        return flipbook(name, dataset.neutral(identity), frames.astype(np.float32), motion.names, motion.times, about)

    meshes = [character("source", source, performed), character("truth", target, truth)]
    for maker in makers:
        frames, solves = _run(maker, problem, seen, console)
        meshes.append(character(maker.name, target, frames, settings=json.dumps(maker.settings), solves=solves))
    about = about_data(config, dataset, motion) | {
        "n_examples": config.n_examples,
        "draw": config.draw,
        "seed": config.seed,
        "examples": [dataset.expressions[i] for i in examples],
    }
    return Scene(stem, dataset.faces, tuple(meshes), about)


def _run(maker: MethodMaker, problem: RetargetProblem, frames: FloatArray, console: Console) -> tuple[FloatArray, str]:
    """Retargeted frames (t, n, 3) mm, and how the solves ended."""
    method = maker.serving(problem)
    print_line(f"  {maker.name}: set-up for the pair and {problem.examples.count} examples", console)
    fitted = method.prepare(problem.pair).fit(problem.examples, problem.source_animation)
    out, statuses = np.empty(frames.shape), Counter[str]()
    with progress(console, maker.name, len(frames)) as advance:
        for start in range(0, len(frames), AT_ONCE):
            part = frames[start : start + AT_ONCE]
            result = fitted(part)
            out[start : start + AT_ONCE] = result.frames
            statuses.update(str(info.status) for info in result.info)
            advance(len(part))
    if not np.isfinite(out).all():
        raise InvalidInput(f"{maker.name}: the method returned NaN or infinite vertices; nothing was written.")
    solves = ", ".join(f"{count} {status}" for status, count in statuses.items())
    if set(statuses) - {str(Status.CONVERGED)}:
        print_line(f"  {maker.name}: not all solves converged: {solves}", console)
    return out, solves


def _stored(config: DictConfig, methods: Sequence[str], free: Free) -> Scene:
    """Frames that a study has kept for its figures: its test expressions, on some of its pairs."""
    folder = Path(config["from"]).expanduser().absolute()
    study = load([folder])[0]
    if not study.figure_cells:
        raise InvalidInput(
            f"{folder}: this study kept no frames. Run it again with study.figures.pairs=1, or leave out `from`: then "
            "the method is run."
        )
    first = _cell(methods[0], study.figure_cells, config)
    cells = [first, *(_cell(name, study.figure_cells, config, first) for name in methods[1:])]
    frames = first.frames
    chosen = select(config.frames, frames.expressions)
    check_targets(len(chosen), config)
    title = str(study.facts["study"])
    stem = f"{title}-{'-'.join(methods)}-{first.source}-to-{first.target}"
    free(stem, 2 + len(methods))
    names, times = [frames.expressions[i] for i in chosen], one_by_one(len(chosen), config.fps)

    def character(name: str, identity: str, neutral: NDArray[Any], all_frames: NDArray[Any]) -> MorphMesh:
        return flipbook(name, neutral.astype(np.float64), all_frames[chosen], names, times, {"identity": identity})

    meshes = [
        character("source", first.source, frames.source_neutral, frames.source),
        character("truth", first.target, frames.target_neutral, frames.truth),
        *(character(cell.method, first.target, frames.target_neutral, cell.frames.retargeted) for cell in cells),
    ]
    conditions = {name: str(study.cells[name].iloc[0]) for name in ("dataset", "truth", "weights", "noise_mm")}
    about = {"what": config.what, "study": title, **conditions, "n_examples": first.n_examples, "draw": first.draw}
    return Scene(stem, frames.faces.astype(np.int64), tuple(meshes), about)


def _cell(method: str, cells: Sequence[FigureCell], config: DictConfig, beside: FigureCell | None = None) -> FigureCell:
    """The stored cell of this method that fits the settings: on the first pair where none is asked for."""
    choose("method", method, dict.fromkeys(cell.method for cell in cells))
    source, target = (beside.source, beside.target) if beside else (config.source, config.target)
    for cell in cells:
        pair = source in (None, cell.source) and target in (None, cell.target)
        if cell.method == method and pair and (cell.n_examples, cell.draw) == (config.n_examples, config.draw):
            return cell
    stored = dict.fromkeys(
        f"source={cell.source} target={cell.target} n_examples={cell.n_examples} draw={cell.draw}"
        for cell in cells
        if cell.method == method
    )
    raise InvalidInput(
        f"from: no frames of {method} with source={source or 'any'} target={target or 'any'} "
        f"n_examples={config.n_examples} draw={config.draw} are stored. There are: {'; '.join(stored)}."
    )


def _methods(config: DictConfig) -> list[MethodMaker]:
    if not config.method:
        raise InvalidInput("method: expected at least one, got none; choose with method=[NAME].")
    settings = cast(Mapping[str, Any], OmegaConf.to_container(config.method, resolve=True))
    for name in settings:
        if name in ("source", "truth"):
            raise InvalidInput(f"method: '{name}' cannot name a character of its own; rename the method.")
    return [MethodMaker(name, settings[name]) for name in settings]


def _pair(config: DictConfig, identities: Sequence[str]) -> tuple[str, str]:
    if len(identities) < 2:
        raise InvalidInput("dataset.identities: expected at least 2, one performs, the other retargets.")
    chosen = {
        setting: choose(setting, str(config[setting]), identities)
        for setting in ("source", "target")
        if config[setting] is not None
    }
    source = chosen.get("source") or next(name for name in identities if name != chosen.get("target"))
    target = chosen.get("target") or next(name for name in identities if name != source)
    if source == target:
        raise InvalidInput(f"target: expected another identity than the source, got {target} for both.")
    return source, target
