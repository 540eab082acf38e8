"""A study as the configuration states it, checked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

from hydra.utils import instantiate

from experiments.catalogue import method_settings, options, sentence
from experiments.correspondence import CORRESPONDENCES, EmbeddingSettings, RiggingSettings
from experiments.protocol import Draw, draw
from experiments.references import REFERENCES
from retarget.check import InvalidInput, check_whole
from retarget.suggest import choose, nearest
from retarget.types import FloatArray, Retargeter
from synth_data.dataset import Dataset

SPANS = ("animation", "five")

Measure = tuple[str, str]  # metric, region


@dataclass(frozen=True)
class Figures:
    """Which frames are kept for the report's pages of heads."""

    pairs: int = 2
    draws: int = 1
    parts: str | None = None  # the method whose named parts are shown


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
    correspondence: tuple[str, ...]
    span: str
    references: tuple[str, ...]
    reference: str
    primary_metric: str
    primary_region: str
    primary_family: tuple[str, ...]
    figures: Figures = field(default_factory=Figures)
    embedding: EmbeddingSettings | None = None  # of the correspondences `embedded` and `paper`
    rigging: RiggingSettings | None = None  # of `ebfr` and `paper`
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # row -> {of: method, setting: value}
    tables: tuple[Measure, ...] = ()
    measures: Mapping[str, tuple[Measure, ...]] = field(default_factory=dict)  # method -> what it is meant to change

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> Study:
        """Raises InvalidInput for a value that no study can have. Of a list of references the first is taken."""
        check_settings("study", config, Study)
        values = dict(config)
        if isinstance(values["reference"], list) and values["reference"]:
            values["reference"] = values["reference"][0]
        if isinstance(values["correspondence"], str):
            values["correspondence"] = [values["correspondence"]]
        for key in ("correspondence", "n_examples", "references", "primary_family"):
            if not isinstance(values[key], list):
                raise InvalidInput(f"study.{key}: expected a list such as [5,15], got {values[key]!r}.")
            values[key] = tuple(values[key])
        if not isinstance(kept := values.pop("figures"), Mapping):
            raise InvalidInput(f"study.figures: expected settings such as {{pairs: 2}}, got {kept!r}.")
        check_settings("study.figures", kept, Figures)
        figures = Figures(**kept)
        for key in ("seed", "draws", "test_expressions"):
            check_whole(f"study.{key}", values[key], 0 if key == "seed" else 1)
        for count in values["n_examples"]:
            check_whole("study.n_examples", count, 0)
        for key in ("pairs", "draws"):
            check_whole(f"study.figures.{key}", getattr(figures, key), 0)
        for name in values["correspondence"]:
            choose("study.correspondence", name, CORRESPONDENCES)
        if not values["correspondence"] or len(set(values["correspondence"])) < len(values["correspondence"]):
            raise InvalidInput(f"study.correspondence: expected different ones, got {values['correspondence']}.")
        embedding, rigging = values.pop("embedding", None), values.pop("rigging", None)
        if {"embedded", "paper"} & set(values["correspondence"]) and embedding is not None:
            values["embedding"] = EmbeddingSettings.from_config(embedding)
        if {"ebfr", "paper"} & set(values["correspondence"]) and rigging is not None:
            values["rigging"] = RiggingSettings.from_config(rigging)
        values["tables"] = _measures("study.tables", values.get("tables", []))
        values["measures"] = {
            name: _measures(f"study.measures.{name}", listed) for name, listed in values.get("measures", {}).items()
        }
        study = Study(**values, figures=figures)
        rows = [*options("method"), *study.variants]
        choose("study.span", study.span, SPANS)
        for name in study.references:
            choose("study.references", name, REFERENCES)
        for name in (study.reference, *study.primary_family):
            choose("study.primary_family" if name != study.reference else "study.reference", name, rows)
        for name in study.measures:
            choose("study.measures", name, rows)
        if figures.parts is not None:
            choose("study.figures.parts", figures.parts, rows)
        if not study.n_examples or len(set(study.n_examples)) < len(study.n_examples):
            raise InvalidInput(f"study.n_examples: expected different counts, got {list(study.n_examples)}.")
        return study

    ordered: ClassVar[bool] = False  # the test expressions are an animation, one after the other

    def data(self, dataset: Dataset) -> Dataset:
        """What is studied, made of the chosen dataset. Raises InvalidInput for one that the study cannot use."""
        return dataset

    def draw(self, source: str, target: str, number: int, expressions: int) -> Draw:
        """Which of so many expressions are tested on a pair, and which serve as examples."""
        return draw(source, target, number, expressions, self.test_expressions, self.seed)

    def noise(self, dataset: Dataset, source: str) -> FloatArray | None:
        """(k, n, 3) mm added to the first k test frames of a source to see how methods respond; None: it is not."""
        return None

    def figure_frames(self, count: int) -> range:
        """Those of so many test frames that are kept for figures."""
        return range(count)

    def keep(self, folder: Path, kept: bool, frames: FloatArray) -> None:
        """Store more of a cell's answer (t, n, 3) mm in its folder; kept: its frames are, for figures."""

    def check_rows(self, methods: Sequence[str]) -> None:
        """Raises InvalidInput unless the method that all rows are compared with is among them."""
        if self.reference not in methods:
            raise InvalidInput(
                f"study.reference: every row is compared with '{self.reference}', which is not among the chosen "
                f"methods {', '.join(methods)}. Add it to method=[...], or set study.reference={methods[0]}."
            )

    def rows(self, methods: Mapping[str, Mapping[str, Any]]) -> tuple[Row, ...]:
        """The chosen methods, given with their settings, then the variants. Raises InvalidInput where one cannot be."""
        chosen = [Row(name, settings, _method(name, settings)) for name, settings in methods.items()]
        return (*chosen, *(self._variant(name, dict(changes), methods) for name, changes in self.variants.items()))

    def _variant(self, name: str, changes: dict[str, Any], methods: Mapping[str, Mapping[str, Any]]) -> Row:
        """The row of `study.variants.<name>`: a chosen method, or another one, with some settings changed."""
        where = f"study.variants.{name}"
        if name in options("method") or name in REFERENCES:
            raise InvalidInput(f"{where}: there is a row of this name already; choose another.")
        if "of" not in changes:
            raise InvalidInput(f"{where}: expected 'of', the name of a method, and settings; got {changes}.")
        of = choose(f"{where}.of", changes.pop("of"), options("method"))
        before = methods[of] if of in methods else method_settings(of)
        known = [field.name for field in fields(_method(of, before))]  # type: ignore[arg-type]
        for setting in changes:
            choose(f"{where}, setting of {of}", setting, known)
        settings = {**before, **changes}
        said = ", ".join(f"{setting} = {value}" for setting, value in changes.items())
        return Row(name, settings, _method(name, settings), f"{of} with {said}." if said else sentence("method", of))


def _measures(name: str, listed: object) -> tuple[Measure, ...]:
    if not isinstance(listed, list) or not all(isinstance(pair, list) and len(pair) == 2 for pair in listed):
        raise InvalidInput(f"{name}: expected a list of [metric, region], got {listed!r}.")
    return tuple((str(metric), str(region)) for metric, region in listed)


def _method(name: str, settings: Mapping[str, Any]) -> Retargeter:
    method = instantiate(settings)
    if not isinstance(method, Retargeter):
        raise InvalidInput(
            f"method {name}: {settings.get('_target_')} makes a {type(method).__name__}, expected a Retargeter."
        )
    return method


def check_settings(where: str, config: Iterable[str], made: type) -> None:
    """Raises InvalidInput for a setting that what is made of them, a dataclass, does not have."""
    known = [field.name for field in fields(made)]
    for name in config:
        if name not in known:
            raise InvalidInput(
                f"{where}.{name}: no setting of this study, expected one of {', '.join(known)}.{nearest(name, known)}"
            )


@dataclass(frozen=True)
class Row:
    """One row of a study's table: a method with its settings, or a reference (method is None)."""

    name: str
    settings: Mapping[str, Any]  # plain data: what decides the row's numbers besides code and data
    method: Retargeter | None = None
    description: str = ""  # a sentence
