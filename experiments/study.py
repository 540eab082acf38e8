"""A study as the configuration states it, checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from experiments.correspondence import correspondence
from experiments.references import REFERENCES
from retarget.check import InvalidInput
from retarget.suggest import choose
from retarget.types import Retargeter

SPANS = ("animation", "five")


@dataclass(frozen=True)
class Figures:
    """Which frames are kept for the report's pages of heads."""

    pairs: int = 2
    draws: int = 1


@dataclass(frozen=True)
class Study:
    """One file of ``conf/study``."""

    name: str
    title: str
    description: str
    seed: int
    n_examples: tuple[int, ...]
    draws: int
    test_expressions: int
    correspondence: str
    span: str
    references: tuple[str, ...]
    reference: str
    primary_metric: str
    primary_region: str
    primary_family: tuple[str, ...]
    figures: Figures = field(default_factory=Figures)

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> Study:
        """Raises InvalidInput for a value that no study can have."""
        values = dict(config)
        for key in ("n_examples", "references", "primary_family"):
            values[key] = tuple(values[key])
        study = Study(**values | {"figures": Figures(**values["figures"])})
        correspondence(study.correspondence)
        choose("study.span", study.span, SPANS)
        for name in study.references:
            choose("study.references", name, REFERENCES)
        if study.draws < 1:
            raise InvalidInput(f"study.draws: expected at least 1, got {study.draws}.")
        if len(set(study.n_examples)) < len(study.n_examples):
            raise InvalidInput(f"study.n_examples: expected different counts, got {list(study.n_examples)}.")
        return study


@dataclass(frozen=True)
class Row:
    """One row of a study's table: a method with its settings, or a reference (method is None)."""

    name: str
    settings: Mapping[str, Any]  # plain data: what decides the row's numbers besides code and data
    method: Retargeter | None = None
