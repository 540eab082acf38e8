"""Prints the table of methods in docs/truths.md: `python docs/truths_table.py [people]`.

One pair is prepared once and fitted under every kind of truth, because people at rest are the same under all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from itertools import permutations

import numpy as np

from experiments.catalogue import make_method
from retarget.types import Examples, Pair
from synth_data.dataset import Dataset
from synth_data.makehuman.dataset import MakeHuman
from synth_data.truth import truth_kinds

METHODS = ("delta", "gradient_transfer", "sumner_popovic", "lbs", "plbs", "ebfr", "alm", "anacondar")
COUNTS, TESTS = (5, 30), 5
EXPRESSIONS = max(COUNTS) + TESTS


def errors(method: str, kinds: Mapping[str, Dataset]) -> Iterator[tuple[str, int, float]]:
    """Mean vertex error in mm on `head` of a method by kind and number of examples, for each ordered pair."""
    data = next(iter(kinds.values()))
    region = data.regions.vertices["head"]
    for source, target in permutations(data.identities, 2):
        prepared = make_method(method).prepare(
            Pair(data.faces, data.neutral(source), data.neutral(target), data.regions)
        )
        for kind, of_kind in kinds.items():
            actor, character = (of_kind.frames(name, range(EXPRESSIONS)) for name in (source, target))
            for count in COUNTS:
                fitted = prepared.fit(Examples(character[:count], actor[:count]), actor)
                found = fitted(actor[-TESTS:]).frames
                yield kind, count, float(np.linalg.norm(found - character[-TESTS:], axis=2)[:, region].mean())


def main(people: str = "2") -> None:
    kinds = {
        kind: MakeHuman(identities=int(people), expressions=EXPRESSIONS, truth=kind).load(print)
        for kind in truth_kinds()
    }
    columns = [(kind, count) for kind in kinds for count in COUNTS]
    print("\n| method |", " | ".join(f"{kind}, {count}" for kind, count in columns), "|")
    print("| --- |", " | ".join("---" for _ in columns), "|")
    for method in METHODS:
        found: dict[tuple[str, int], list[float]] = {column: [] for column in columns}
        for kind, count, error in errors(method, kinds):
            found[kind, count].append(error)
        print(f"| `{method}` |", " | ".join(f"{np.mean(found[column]):.3f}" for column in columns), "|", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
