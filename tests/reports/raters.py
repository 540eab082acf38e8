"""Synthetic raters whose true preference is known, and a questionnaire's key without a study: for tests alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from string import ascii_uppercase

import numpy as np
from scipy.stats import rankdata

from reports import questionnaire
from reports.questionnaire import Example, Item, Key

METHODS = ("full", "near", "far", "worst")
HEADER = "participant,item,letter,rank,raters"


def make_key(items: int = 15, counts: Sequence[int] = (5, 15, 30), methods: Sequence[str] = METHODS) -> Key:
    """Items in random orders of letters; the reference is the first method."""
    rng = np.random.default_rng(11)
    made = tuple(
        Item(
            number=i + 1,
            n_examples=counts[i % len(counts)],
            source="a",
            target="b",
            draw=0,
            expression=f"expression_{i:03d}",
            example=Example("neutral"),
            letters=dict(zip(ascii_uppercase, rng.permutation(methods).tolist(), strict=False)),
            vertex_error_mm={method: 0.1 + 0.1 * j for j, method in enumerate(methods)},
        )
        for i in range(items)
    )
    design = {"name": "peers", "question": "Which?", "reference": methods[0], "target_example": "neutral"}
    facts = {"study": "made up", "title": "Made up", "conditions": {"dataset": "none"}}
    hashes = {"code": "c" * 64, "data": "d" * 64, "results": "e" * 64}
    key = Key(id="", design=design, labels={m: m for m in methods}, items=made, **facts, **hashes)  # type: ignore[arg-type]
    return Key(**{**{name: getattr(key, name) for name in asdict(key)}, "id": questionnaire._id(key)})


def rank(
    key: Key,
    utilities: Sequence[float],
    people: int,
    seed: int,
    taste: float = 0.0,
    look: float = 0.0,
    noise: float = 1.0,
) -> dict[tuple[str, int, str], int]:
    """(participant, item, letter) -> rank of raters who judge by utility, one for each method, and Gaussian noise.

    taste is the standard deviation by which one person values a method otherwise on all items, look that by which one
    item shows a method to advantage for all people: what makes single rankings depend on each other.
    """
    rng = np.random.default_rng(seed)
    tastes = taste * rng.normal(size=(people, len(utilities)))
    looks = look * rng.normal(size=(len(key.items), len(utilities)))
    given: dict[tuple[str, int, str], int] = {}
    for p in range(people):
        for i, item in enumerate(key.items):
            value = np.asarray(utilities) + tastes[p] + looks[i] + noise * rng.normal(size=len(utilities))
            ranks = dict(zip(key.methods, rankdata(-value).astype(int).tolist(), strict=True))
            given |= {(f"p{p:02d}", item.number, letter): ranks[m] for letter, m in item.letters.items()}
    return given


def write(path: Path, given: dict[tuple[str, int, str], int], raters: str = "synthetic") -> Path:
    """A CSV as the form hands it out, marked by who ranked."""
    lines = [HEADER, *(f"{p},{item},{letter},{rank},{raters}" for (p, item, letter), rank in given.items())]
    path.write_text("\n".join(lines) + "\n")
    return path
