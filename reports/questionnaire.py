"""What raters are asked: which results of a finished study, under which letters, and the key that names them.

The design of the paper (section 4.3, Figs B.16 and B.17): retargeted expressions at several example counts, the
results of all methods under letters in random order.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from string import ascii_uppercase
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from reports.load import FigureCell, Frames, StudyResults
from retarget.check import InvalidInput, check_whole
from retarget.io.files import write_whole
from retarget.suggest import choose

SCHEMA = 1
Mesh = NDArray[np.floating[Any]]  # (n, 3) mm
EXAMPLES = {  # pictures of the target beside the source: what a rater reads above them
    "similar": "Target, another real expression",
    "neutral": "Target, neutral",
    "truth": "Target, the same expression",
    "none": "",
}
ITEMS = 5  # for each example count, as in the paper
_MOST_METHODS = 8  # pictures that a person can rank, and that fit a page


@dataclass(frozen=True)
class Design:
    """One file of ``conf/questionnaire``.

    n_examples: None stands for all counts of the study. items: for each count; None stands for 5, or as many as the
    frames that the study kept allow. distinct: whether an expression of a pair is asked about once only, or once for
    each count. target_example: a key of EXAMPLES.
    """

    name: str
    question: str
    methods: tuple[str, ...]
    reference: str
    target_example: str
    n_examples: tuple[int, ...] | None = None
    items: int | None = None
    distinct: bool = True
    seed: int = 0

    @staticmethod
    def from_config(config: Mapping[str, Any]) -> Design:
        """Raises InvalidInput for a value that no questionnaire can have."""
        values = dict(config)
        methods, counts = values.pop("methods"), values.pop("n_examples")
        if not isinstance(methods, list) or not 2 <= len(set(methods)) == len(methods) <= _MOST_METHODS:
            raise InvalidInput(
                f"questionnaire.methods: expected 2 to {_MOST_METHODS} different rows of the study, got {methods!r}."
            )
        design = Design(methods=tuple(methods), n_examples=None if counts is None else tuple(counts), **values)
        choose("questionnaire.reference", design.reference, design.methods)
        choose("questionnaire.target_example", design.target_example, EXAMPLES)
        for name, value, least in (("items", design.items, 1), ("seed", design.seed, 0)):
            if name == "items" and value is None:
                continue
            check_whole(f"questionnaire.{name}", value, least)
        return design


@dataclass(frozen=True, order=True)
class Instance:
    """One expression that one identity performs and another retargets, from one draw of examples."""

    source: str
    target: str
    expression: str
    draw: int
    frame: int  # of the cell's frames

    @property
    def pair(self) -> tuple[str, str]:
        return self.source, self.target

    @property
    def performed(self) -> tuple[str, str, str]:
        """What a rater would recognise, whatever the draw."""
        return self.source, self.target, self.expression


@dataclass(frozen=True)
class Example:
    """The picture of the target beside the source. distance: of a similar expression, as a share of the motion."""

    kind: str
    expression: str | None = None
    distance: float | None = None


@dataclass(frozen=True)
class Item:
    """One question. letters: letter -> method. vertex_error_mm: mean over the head, method -> mm."""

    number: int
    n_examples: int
    source: str
    target: str
    draw: int
    expression: str
    example: Example
    letters: Mapping[str, str]
    vertex_error_mm: Mapping[str, float]


@dataclass(frozen=True)
class Key:
    """Which letter is which method: everything that an analysis of rankings needs, and no rater may see."""

    id: str  # of the questionnaire; equal ids mean equal questions
    study: str
    title: str
    conditions: Mapping[str, Any]
    code: str
    data: str
    results: str  # SHA-256 over the frames that the pictures show
    design: Mapping[str, Any]
    labels: Mapping[str, str]  # method -> printed name
    items: tuple[Item, ...]

    @property
    def methods(self) -> tuple[str, ...]:
        return tuple(self.labels)

    @property
    def reference(self) -> str:
        return str(self.design["reference"])

    @property
    def counts(self) -> tuple[int, ...]:
        return tuple(sorted({item.n_examples for item in self.items}))


@dataclass(frozen=True)
class Shown:
    """What one item's pictures are made of, in mm."""

    item: Item
    frames: Frames
    source: Mesh  # (n, 3)
    example: Mesh | None  # (n, 3)
    results: Mapping[str, Mesh]  # letter -> (n, 3)


@dataclass(frozen=True)
class Questionnaire:
    key: Key
    shown: tuple[Shown, ...]
    cells: tuple[FigureCell, ...]
    sparse: str = ""  # why there are fewer items than in the paper, and what to do


def questionnaire(study: StudyResults, design: Design) -> Questionnaire:
    """Draw the items of a questionnaire: the same study and design give the same one.

    Raises InvalidInput for methods or counts that the study does not have, and where it kept too few frames.
    """
    for method in design.methods:
        if method not in study.tested:
            raise InvalidInput(
                f"questionnaire.methods: the study '{study.facts['study']}' has no row '{method}', it has "
                f"{', '.join(study.tested)}. Run it with 'method=[{','.join(design.methods)}]', or ask about others: "
                "'questionnaire.methods=[NAME,NAME]'."
            )
    counts = design.n_examples or tuple(study.facts["n_examples"])
    for count in counts:
        choose("questionnaire.n_examples", str(count), map(str, study.facts["n_examples"]))
    kept = {
        (c.method, c.n_examples, c.source, c.target, c.draw): c
        for c in study.figure_cells
        if c.method in design.methods and c.n_examples in counts
    }
    instances = {count: list(_instances(kept, design.methods, count)) for count in counts}
    if not any(instances.values()):
        raise _no_frames(study, design)
    asked, drawn, rng = _fitting(instances, study, design)
    lettered = _letters(design.methods, len(drawn), rng)
    order = rng.permutation(len(drawn))
    performances = _performances(study) if design.target_example == "similar" else {}
    placed = [(*drawn[int(i)], lettered[int(i)]) for i in order]
    shown = tuple(
        _shown(number, count, one, letters, kept, performances, design)
        for number, (count, one, letters) in enumerate(placed, start=1)
    )
    used = sorted(
        {
            kept[(m, s.item.n_examples, s.item.source, s.item.target, s.item.draw)]
            for s in shown
            for m in design.methods
        },
        key=lambda c: str(c.path),
    )
    sparse = _sparse(instances, study, asked) if design.items is None and asked.items != ITEMS else ""
    return Questionnaire(_key(study, asked, [s.item for s in shown], used), shown, tuple(used), sparse)


def write_key(path: Path, key: Key) -> None:
    """Write the key as JSON. Raises InvalidInput if another questionnaire's key is there: its rankings need it."""
    if path.exists() and (there := read_key(path).id) != key.id:
        raise InvalidInput(
            f"{path}: this is the key of another questionnaire ({there}, the new one is {key.id}), and rankings for it "
            "cannot be read without. Nothing was written. Choose another folder with output=FOLDER, or move that one."
        )
    text = json.dumps({"schema": SCHEMA, **asdict(key)}, indent=1)
    write_whole(path, lambda temporary: temporary.write_text(text + "\n", encoding="utf-8"))


def read_key(path: Path) -> Key:
    """Raises InvalidInput for a file that is no key, or was changed since it was written."""
    mend = "Name the key.json that was written with the questionnaire: key=FILE."
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        schema = found.pop("schema")
        items = [Item(**{**item, "example": Example(**item["example"])}) for item in found.pop("items")]
        key = Key(items=tuple(items), **found)
    except FileNotFoundError as error:
        raise InvalidInput(f"{path}: there is no such key. {mend}") from error
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise InvalidInput(
            f"{path}: expected the key of a questionnaire, this cannot be read as one. {mend}"
        ) from error
    if schema != SCHEMA:
        raise InvalidInput(f"{path}: this key has schema {schema}, this version reads schema {SCHEMA}. {mend}")
    if key.id != _id(key):
        raise InvalidInput(f"{path}: this key was changed after it was written: its id does not fit it. {mend}")
    return key


def _instances(
    kept: Mapping[tuple[str, int, str, str, int], FigureCell], methods: Sequence[str], count: int
) -> Iterator[Instance]:
    """What all methods have kept frames of at one example count, sorted."""
    cells = sorted(key[2:] for key in kept if key[:2] == (methods[0], count))
    for source, target, draw in cells:
        if all((method, count, source, target, draw) in kept for method in methods):
            with np.load(kept[(methods[0], count, source, target, draw)].path) as archive:  # the names alone
                expressions = [str(name) for name in archive["expressions"]]
            for frame, expression in enumerate(expressions):
                yield Instance(source, target, expression, draw, frame)


def _fitting(
    instances: Mapping[int, Sequence[Instance]], study: StudyResults, design: Design
) -> tuple[Design, list[tuple[int, Instance]], np.random.Generator]:
    """The design with its number of items, what `_draw` made of it, and the generator that goes on from there."""
    for items in [design.items] if design.items is not None else range(ITEMS, 0, -1):
        rng = np.random.default_rng(design.seed)
        if drawn := _draw(instances, items, design.distinct, rng):
            return replace(design, items=items), drawn, rng
    raise _too_few(instances, study, replace(design, items=design.items or 1))


def _draw(
    instances: Mapping[int, Sequence[Instance]], items: int, distinct: bool, rng: np.random.Generator
) -> list[tuple[int, Instance]]:
    """(count, instance), balanced over counts, and at each count over pairs and then over expressions.

    Empty where there are too few instances.
    """
    drawn: list[tuple[int, Instance]] = []
    asked: set[tuple[str, str, str]] = set()
    pairs, expressions = Counter[tuple[str, str]](), Counter[str]()
    for count in sorted(instances, key=lambda count: (len(instances[count]), count)):
        here = Counter[tuple[str, str]]()
        mine: set[tuple[str, str, str]] = set()
        for _ in range(items):
            taken = mine | asked if distinct else mine
            free = [one for one in instances[count] if one.performed not in taken]
            if not free:
                return []
            chance = rng.permutation(len(free)).tolist()
            best = min(
                zip(free, chance, strict=True),
                key=lambda f: (here[f[0].pair], pairs[f[0].pair], expressions[f[0].expression], f[1]),
            )[0]
            drawn.append((count, best))
            mine.add(best.performed)
            here[best.pair] += 1
            pairs[best.pair] += 1
            expressions[best.expression] += 1
        asked |= mine
    return drawn


def _sparse(instances: Mapping[int, Sequence[Instance]], study: StudyResults, design: Design) -> str:
    different = {one.performed for ones in instances.values() for one in ones}
    pairs = _pairs(study)
    return (
        f"{design.items} for each of {_listed(sorted(instances))} examples instead of {ITEMS}: the study kept the "
        f"frames of {len({d[:2] for d in different})} of {pairs} pairs, {len(different)} expressions. To ask for more, "
        f"run it again with study.figures.pairs={pairs}, or set questionnaire.distinct=false."
    )


def _pairs(study: StudyResults) -> int:
    identities = len(study.facts["identities"])
    return identities * (identities - 1)


def _no_frames(study: StudyResults, design: Design) -> InvalidInput:
    kept = [name for name in design.methods if any(cell.method == name for cell in study.figure_cells)]
    had = f"only those of {', '.join(kept)}, or of other pairs and draws" if kept else "none of them"
    return InvalidInput(
        f"questionnaire: expected frames of {', '.join(design.methods)}, which the pictures are made of; "
        f"{study.folder} has {had}. Run the study again with study.figures.pairs=2, or more for more items: that is of "
        "how many pairs frames are kept. If it kept them, copy the folder with all that is in it."
    )


def _too_few(instances: Mapping[int, Sequence[Instance]], study: StudyResults, design: Design) -> InvalidInput:
    different = {one.performed for ones in instances.values() for one in ones}
    fewest = min(len({one.performed for one in ones}) for ones in instances.values())
    wanted = (design.items or 1) * (len(instances) if design.distinct else 1)
    pairs = _pairs(study)
    shape = f"{len(different)} expressions of {len({d[:2] for d in different})} of {pairs} pairs"
    sparser = ", or 'questionnaire.distinct=false' to ask about an expression once for each count"
    return InvalidInput(
        f"questionnaire: expected {design.items} expressions for each of {_listed(sorted(instances))} examples, "
        f"{wanted} different ones{'' if design.distinct else ' at each count'}, of which the frames of all of "
        f"{', '.join(design.methods)} were kept; {study.folder} has {shape}, and "
        f"{fewest} at the number of examples with the fewest. Keep more frames: run the study again with "
        f"study.figures.pairs={pairs} (and study.figures.draws=2), cells whose frames were kept are used again. "
        f"Or ask less: questionnaire.items=N{sparser if design.distinct else ''}."
    )


def _letters(methods: Sequence[str], count: int, rng: np.random.Generator) -> list[dict[str, str]]:
    """A random order for each item. Within each block of as many items as methods (a Latin square) a method has each
    letter once, so that a preference for a place favours no method."""
    orders: list[list[str]] = []
    while len(orders) < count:
        square = [str(name) for name in rng.permutation(methods)]
        orders += [square[shift:] + square[:shift] for shift in rng.permutation(len(square)).tolist()]
    return [dict(zip(ascii_uppercase, order, strict=False)) for order in orders[:count]]


def _shown(
    number: int,
    count: int,
    one: Instance,
    letters: Mapping[str, str],
    kept: Mapping[tuple[str, int, str, str, int], FigureCell],
    performances: Mapping[str, Mapping[str, Mesh]],
    design: Design,
) -> Shown:
    cells = {method: kept[(method, count, one.source, one.target, one.draw)] for method in design.methods}
    frames = cells[design.reference].frames
    example, picture = _example(design.target_example, one, frames, performances.get(one.target, {}))
    errors = {m: round(float(np.nanmean(cell.frames.error(one.frame))), 6) for m, cell in cells.items()}
    item = Item(number, count, one.source, one.target, one.draw, one.expression, example, dict(letters), errors)
    results = {letter: cells[method].frames.retargeted[one.frame] for letter, method in letters.items()}
    return Shown(item, frames, frames.source[one.frame], picture, results)


def _example(kind: str, one: Instance, frames: Frames, performance: Mapping[str, Mesh]) -> tuple[Example, Mesh | None]:
    if kind == "none":
        return Example(kind), None
    if kind == "neutral":
        return Example(kind), frames.target_neutral
    if kind == "truth":
        return Example(kind, one.expression), frames.truth[one.frame]
    return _similar(one, frames, performance)


def _similar(one: Instance, frames: Frames, performance: Mapping[str, Mesh]) -> tuple[Example, Mesh]:
    """The target's own performance of another expression that is nearest to its performance of this one."""
    # differs from the paper: it does not say how its example was chosen; only kept expressions can be shown
    truth, head = frames.truth[one.frame], frames.head
    distances = {
        name: float(np.linalg.norm(other[head] - truth[head], axis=1).mean())
        for name, other in performance.items()
        if name != one.expression
    }
    if not distances:
        raise InvalidInput(
            f"questionnaire.target_example: no other expression of {one.target} was kept, expected at least one. "
            "Choose 'neutral' or 'none', or run the study with study.test_expressions=5."
        )
    name = min(distances, key=lambda name: (distances[name], name))
    motion = float(np.linalg.norm(truth[head] - frames.target_neutral[head], axis=1).mean())
    return Example("similar", name, round(distances[name] / motion, 3) if motion > 0 else None), performance[name]


def _performances(study: StudyResults) -> dict[str, dict[str, Mesh]]:
    """target -> expression -> (n, 3) mm: all that the study kept of the identities' own performances."""
    found: dict[str, dict[str, Mesh]] = {}
    read: set[tuple[str, str, int]] = set()
    for cell in study.figure_cells:
        if (at := (cell.source, cell.target, cell.draw)) not in read:
            read.add(at)
            with np.load(cell.path) as archive:
                names, truth = archive["expressions"], archive["truth"]
            mine = found.setdefault(cell.target, {})
            for name, frame in zip(names, truth, strict=True):
                mine.setdefault(str(name), frame)
    return found


def _key(study: StudyResults, design: Design, items: Sequence[Item], cells: Sequence[FigureCell]) -> Key:
    results = hashlib.sha256()
    for cell in cells:
        results.update(hashlib.sha256(cell.path.read_bytes()).digest())
    facts = study.facts
    key = Key(
        id="",
        study=str(facts["study"]),
        title=str(facts["title"]),
        conditions={name: study.cells[name].iloc[0] for name in ("dataset", "truth", "weights", "correspondence")}
        | {"noise_mm": float(study.cells["noise_mm"].iloc[0])},
        code=str(facts["provenance"]["code_hash"]),
        data=str(facts["dataset"]["fingerprint"]),
        results=results.hexdigest(),
        design=_plain(design),
        labels={method: study.label(method) for method in design.methods},
        items=tuple(items),
    )
    return Key(**{**_fields(key), "id": _id(key)})


def _id(key: Key) -> str:
    """12 hexadecimal digits of a SHA-256 over all of the key but its id."""
    content = {name: value for name, value in asdict(key).items() if name != "id"}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]


def _fields(key: Key) -> dict[str, Any]:
    return {name: getattr(key, name) for name in key.__dataclass_fields__}


def _plain(design: Design) -> dict[str, Any]:
    return cast(dict[str, Any], json.loads(json.dumps(asdict(design))))


def _listed(values: Sequence[int]) -> str:
    *first, last = map(str, values)
    return f"{', '.join(first)} and {last}" if first else last
