"""Methods over an animation: error over time, restlessness, response to noise, and identity kept over sources.

Every method is fitted to the examples of the comparison and then retargets the whole animation in its order. The rest
is a comparison whose test expressions are the frames: its records, tables, statistics and report.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from experiments.animation import Animated, Take, take
from experiments.metrics.identity_spread import identity_spread
from experiments.plan import Plan
from experiments.protocol import Draw, draw
from experiments.study import Row, Study
from reports.temporal_sheet import build_temporal_sheet
from retarget.check import check_whole
from retarget.io.files import write_whole
from retarget.io.gltf import write_glb
from retarget.io.morph_mesh import MorphMesh
from retarget.io.principal_shapes import principal_shapes
from retarget.types import FloatArray
from synth_data.dataset import Dataset
from synth_data.noise import ScanNoise, check_noise

MOTION = "motion.npz"
SAMPLES = 6  # frames of every cell that are kept to compare sources


@dataclass(frozen=True, kw_only=True)
class TemporalStudy(Study):
    """``conf/study/temporal.yaml``; `test_expressions` is the number of frames."""

    ordered: ClassVar[bool] = True
    performed: Take
    held_out: int  # expressions that are no examples, as in the comparison
    noise_mm: float
    noise_frames: int
    streaming: bool

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> TemporalStudy:
        """Raises InvalidInput for a value that the study cannot have, and for a take as `animation.take` does."""
        values = dict(config)
        asked = (values.pop(name) for name in ("recording", "start", "seconds", "fps", "animation_seed"))
        own = {name: values.pop(name) for name in ("noise_mm", "noise_frames", "streaming")}
        check_whole("study.noise_frames", own["noise_frames"], 1)
        own["noise_mm"] = check_noise("study.noise_mm", own["noise_mm"])
        performed, held_out = take(*asked), values["test_expressions"]
        study = Study.from_config(values)
        common = {field.name: getattr(study, field.name) for field in fields(study)}
        common["test_expressions"] = len(performed.weights)
        return TemporalStudy(**common, **own, performed=performed, held_out=held_out)

    def data(self, dataset: Dataset) -> Dataset:
        return Animated.of(dataset, self.performed)

    def rows(self, methods: Mapping[str, Mapping[str, Any]]) -> tuple[Row, ...]:
        """Methods that can start a solve from the frame before do so, if the study says so."""
        chosen = {
            name: {**settings, "streaming": self.streaming} if "streaming" in settings else settings
            for name, settings in methods.items()
        }
        return super().rows(chosen)

    def draw(self, source: str, target: str, number: int, expressions: int) -> Draw:
        """All frames in their order, and the examples that the comparison draws."""
        still = expressions - self.test_expressions
        examples = draw(source, target, number, still, self.held_out, self.seed).order
        return Draw(number, tuple(range(still, expressions)), examples)

    def noise(self, dataset: Dataset, source: str) -> FloatArray | None:
        """Noise of a scanner, another one in each frame."""
        if self.noise_mm == 0:
            return None
        scanned = ScanNoise(source, dataset.neutral(source), dataset.faces)
        count = min(self.noise_frames, self.test_expressions)
        return self.noise_mm * np.stack([scanned(f"restless-{i}") for i in range(count)])

    def figure_frames(self, count: int) -> range:
        return _samples(count)

    def keep(self, folder: Path, kept: bool, frames: FloatArray) -> None:
        """All frames where figures are kept, or else some."""
        chosen = range(len(frames)) if kept else _samples(len(frames))
        stored = {"frames": np.array(chosen), "retargeted": frames[list(chosen)].astype(np.float32)}

        def save(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez_compressed(file, **stored)  # type: ignore[arg-type]

        write_whole(folder / MOTION, save)


def _samples(count: int) -> range:
    """Frames spread over an animation of so many."""
    step = max(count // SAMPLES, 1)
    return range(step // 2, count, step)


def write_animation(study: TemporalStudy, planned: Plan) -> Iterator[Path]:
    """What a comparison does not write: ``identity.csv``, ``times.csv``, ``animation.glb`` and ``temporal.pdf``."""
    folder = planned.folder
    spread = pd.DataFrame(_spreads(planned), columns=["method", "target", "n_examples", "sources", "spread_mm"])
    write_whole(folder / "identity.csv", lambda path: spread.to_csv(path, index=False))
    times = pd.DataFrame({"expression": planned.dataset.expressions[-len(study.performed.times) :]})
    times["seconds"] = study.performed.times
    write_whole(folder / "times.csv", lambda path: times.to_csv(path, index=False))
    if meshes := _side_by_side(study, planned):
        about = {"study": study.name, "take": study.performed.name, **vars(planned.dataset.conditions)}
        write_glb(folder / "animation.glb", planned.dataset.faces, meshes, about, normals=False)
        yield folder / "animation.glb"
    yield build_temporal_sheet(folder)


def _spreads(planned: Plan) -> Iterator[tuple[str, str, int, int, float]]:
    """The visible skin's spread over the sources that a method finished, for each target and number of examples."""
    every = np.arange(len(planned.dataset.neutral(planned.dataset.identities[0])))
    head = planned.dataset.regions.vertices.get("head", every)
    groups: dict[tuple[str, str, int], list[FloatArray]] = {}
    for cell in planned.cells:
        if cell.draw == 0 and (stored := _motion(planned.folder / cell.id)) is not None:
            at = np.isin(stored[0], list(_samples(planned.study.test_expressions)))
            groups.setdefault((cell.row.name, cell.target, cell.n_examples), []).append(stored[1][at][:, head])
    for (method, target, n_examples), frames_of in groups.items():
        if len(frames_of) > 1:
            spread = identity_spread(np.stack(frames_of).astype(np.float64))
            yield method, target, n_examples, len(frames_of), spread


def _motion(folder: Path) -> tuple[Any, Any] | None:
    """Numbers of frames (k,), and frames (k, n, 3) mm."""
    if not (folder / MOTION).exists():
        return None
    with np.load(folder / MOTION, allow_pickle=False) as archive:
        return archive["frames"], archive["retargeted"]


def _side_by_side(study: TemporalStudy, planned: Plan) -> list[MorphMesh]:
    """Source, truth and every method with all its frames, on the first pair with the most examples."""
    kept = [cell for cell in planned.cells if cell.keep_frames and cell.n_examples == max(study.n_examples)]
    if not kept:
        return []
    pair, data = (kept[0].source, kept[0].target), planned.dataset
    frames = range(len(data.expressions) - study.test_expressions, len(data.expressions))
    shown = {"source": (pair[0], data.frames(pair[0], frames)), "truth": (pair[1], data.frames(pair[1], frames))}
    for cell in kept:
        stored = _motion(planned.folder / cell.id)
        if (cell.source, cell.target) == pair and cell.draw == 0 and cell.row.method and stored is not None:
            shown.setdefault(cell.row.name, (pair[1], stored[1].astype(np.float64)))
    return [
        replace(principal_shapes(name, data.neutral(who), moved, study.performed.times), about={"identity": who})
        for name, (who, moved) in shown.items()
    ]
