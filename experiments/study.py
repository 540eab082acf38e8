"""A study as the configuration states it, checked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from experiments.catalogue import options
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
            if not isinstance(values[key], list):
                raise InvalidInput(f"study.{key}: expected a list such as [5,15], got {values[key]!r}.")
            values[key] = tuple(values[key])
        figures = Figures(**values.pop("figures"))
        for key in ("seed", "draws", "test_expressions"):
            _whole(f"study.{key}", values[key], 0 if key == "seed" else 1)
        for count in values["n_examples"]:
            _whole("study.n_examples", count, 0)
        for key in ("pairs", "draws"):
            _whole(f"study.figures.{key}", getattr(figures, key), 0)
        study = Study(**values, figures=figures)
        correspondence(study.correspondence)
        choose("study.span", study.span, SPANS)
        for name in study.references:
            choose("study.references", name, REFERENCES)
        for name in (study.reference, *study.primary_family):
            choose("study.primary_family" if name != study.reference else "study.reference", name, options("method"))
        if not study.n_examples or len(set(study.n_examples)) < len(study.n_examples):
            raise InvalidInput(f"study.n_examples: expected different counts, got {list(study.n_examples)}.")
        return study

    def check_rows(self, methods: Sequence[str]) -> None:
        """Raises InvalidInput unless the method that all rows are compared with is among them."""
        if self.reference not in methods:
            raise InvalidInput(
                f"study.reference: every row is compared with '{self.reference}', which is not among the chosen "
                f"methods {', '.join(methods)}. Add it to method=[...], or set study.reference={methods[0]}."
            )


def _whole(name: str, value: object, least: int) -> None:
    if not isinstance(value, int) or isinstance(value, bool) or value < least:
        raise InvalidInput(f"{name}: expected a whole number of at least {least}, got {value!r}.")


@dataclass(frozen=True)
class Row:
    """One row of a study's table: a method with its settings, or a reference (method is None)."""

    name: str
    settings: Mapping[str, Any]  # plain data: what decides the row's numbers besides code and data
    method: Retargeter | None = None
