"""A study expanded into its cells, eagerly, before anything runs."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from experiments.correspondence import EmbeddingSettings, RiggingSettings
from experiments.evaluate import Cell, PairTask
from experiments.metrics.metric import Comparison, Metric, lacking
from experiments.protocol import check_counts
from experiments.record import SCHEMA, digest, read_header
from experiments.study import Row, Study
from experiments.version import code_hash
from retarget.check import InvalidInput, check_faces, check_frames, check_triangle_areas, check_vertices
from retarget.suggest import choose
from retarget.types import Regions
from synth_data.dataset import Dataset
from synth_data.makehuman.regions import load_regions


@dataclass(frozen=True)
class Plan:
    """All cells of a study, in the order of its table."""

    study: Study
    dataset: Dataset
    metrics: tuple[Metric, ...]
    rows: tuple[Row, ...]
    cells: tuple[Cell, ...]
    folder: Path
    left_out: Mapping[str, str] = field(default_factory=dict)  # chosen metrics that cannot measure this data: reason

    def finished(self, cell: Cell) -> Mapping[str, Any] | None:
        """The header of a cell whose record is there and current; raises InvalidInput for an old schema."""
        header = read_header(self.folder / cell.id)
        if header is None or header["code"] != code_hash() or header["data"] != self.dataset.fingerprint:
            return None
        return header

    def tasks(self, cells: Sequence[Cell]) -> Iterator[PairTask]:
        """The unit of work: one for each pair that has a cell among `cells`."""
        for _, group in itertools.groupby(cells, key=lambda cell: (cell.source, cell.target)):
            yield PairTask(self.study, self.dataset, self.metrics, tuple(group), self.folder, code_hash())


def plan(
    study: Study,
    dataset: Dataset,
    methods: Sequence[Row],
    metrics: Mapping[str, tuple[Metric, Mapping[str, Any]]],
    folder: Path,
) -> Plan:
    """Expand a study; `metrics` holds each metric with its settings.

    A metric that cannot measure the topology is left out. Raises InvalidInput if the study cannot be run.
    """
    check_counts(len(dataset.expressions), study.test_expressions, study.n_examples)
    check_dataset(dataset)
    study.check_rows([row.name for row in methods])
    metrics, left_out = _measurable(metrics, dataset.regions)
    check_metrics(study, dataset, {name: metric for name, (metric, _) in metrics.items()})
    rows = (*methods, *(Row(name, {"reference": name}) for name in study.references))
    pairs = list(itertools.permutations(dataset.identities, 2))
    protocol = {
        "schema": SCHEMA,
        "conditions": asdict(dataset.conditions),
        "seed": study.seed,
        "test_expressions": study.test_expressions,
        "span": study.span,
        "metrics": {name: dict(settings) for name, (_, settings) in metrics.items()},
    }
    cells = []
    for number, (source, target) in enumerate(pairs):
        for row, correspondence, n_examples, draw in itertools.product(
            rows, study.correspondence, study.n_examples, range(study.draws)
        ):
            keep = number < study.figures.pairs and draw < study.figures.draws
            identity = {
                "protocol": protocol,
                "row": row.name,
                "settings": dict(row.settings),
                "correspondence": correspondence,
                "embedding": _facts(study.embedding, correspondence in ("embedded", "paper")),
                "rigging": _facts(study.rigging, correspondence in ("ebfr", "paper")),
                "pair": [source, target],
                "n_examples": n_examples,
                "draw": draw,
                "frames": keep,
            }
            cells.append(Cell(digest(identity)[:20], row, correspondence, source, target, n_examples, draw, keep))
    measured = tuple(metric for metric, _ in metrics.values())
    return Plan(study, dataset, measured, rows, tuple(cells), folder, left_out)


def _facts(settings: EmbeddingSettings | RiggingSettings | None, used: bool) -> dict[str, Any] | None:
    return dict(settings.facts) if settings and used else None


def check_dataset(dataset: Dataset) -> None:
    """Raises InvalidInput for data that no study can use, naming the identity; noise is part of it."""
    if len(dataset.identities) < 2:
        raise InvalidInput(
            f"dataset: {len(dataset.identities)} identities, expected at least 2: one performs, the other retargets. "
            "Raise dataset.identities, or add a second folder."
        )
    count = len(dataset.neutral(dataset.identities[0]))
    faces = check_faces(f"{dataset.conditions.dataset}: faces", dataset.faces, count)
    everything = range(len(dataset.expressions))
    for identity in dataset.identities:
        neutral = check_vertices(f"{identity}, neutral", dataset.neutral(identity), count)
        check_triangle_areas(f"{identity}, neutral", neutral, faces)
        if dataset.conditions.noise_mm > 0:
            check_triangle_areas(f"{identity}, scanned neutral", dataset.scanned_neutral(identity), faces)
        check_frames(f"{identity}, expressions", dataset.frames(identity, everything), count)


def _measurable(
    metrics: Mapping[str, tuple[Metric, Mapping[str, Any]]], regions: Regions
) -> tuple[dict[str, tuple[Metric, Mapping[str, Any]]], dict[str, str]]:
    """The metrics that this topology allows, on those of their regions that it names, and what is left out and why.

    Only regions of docs/regions.md are left out: any other name is a mistake, which the metric itself refuses.
    """
    known = load_regions().vertices
    measurable, left_out = {}, {}
    for name, (metric, settings) in metrics.items():
        if reason := metric.unsupported(regions):
            left_out[name] = reason
            continue
        wanted = list(getattr(metric, "regions", ()))
        missing = [region for region in wanted if region in known and region not in regions.vertices]
        if missing:
            left_out[name if missing == wanted else f"{name} in {', '.join(missing)}"] = str(
                lacking("vertices", missing, regions.vertices)
            )
            metric = replace(metric, regions=[region for region in wanted if region not in missing])  # type: ignore[type-var]
        if missing != wanted or not wanted:
            measurable[name] = metric, settings
    return measurable, left_out


def check_metrics(study: Study, dataset: Dataset, metrics: Mapping[str, Metric]) -> None:
    """Measure a neutral once: a metric that cannot serve this data is found before anything is computed.

    Raises InvalidInput for such a metric, and where none measures what the study tests.
    """
    neutral = dataset.neutral(dataset.identities[0])
    still = neutral[None]
    comparison = Comparison(
        still, still, still, neutral, neutral, dataset.faces, dataset.regions, ordered=study.ordered
    )
    measured: dict[str, list[str]] = {}
    for name, metric in metrics.items():
        try:
            for measurement in metric(comparison):
                if np.shape(measurement.values) != (1,):
                    raise ValueError(f"expected one value for each frame, got shape {np.shape(measurement.values)}")
                measured.setdefault(measurement.metric, []).append(measurement.region)
        except InvalidInput:
            raise
        except Exception as error:
            raise InvalidInput(f"metric '{name}' fails on this dataset: {type(error).__name__}: {error}.") from error
    choose("study.primary_metric", study.primary_metric, measured)
    choose("study.primary_region", study.primary_region, measured[study.primary_metric])
