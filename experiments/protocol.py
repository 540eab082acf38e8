"""Which expressions are tested and which serve as examples: nested, seeded, shared by all methods."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from retarget.check import InvalidInput


@dataclass(frozen=True)
class Draw:
    """One draw of a pair: test expressions held out, and an order in which the others become examples."""

    number: int
    test: tuple[int, ...]  # indices of expressions, fixed across example counts
    order: tuple[int, ...]  # a permutation of the other expressions

    def examples(self, count: int) -> tuple[int, ...]:
        """The first `count` of the order: 5 examples lie within 15 within 30."""
        return self.order[:count]


def draw(source: str, target: str, number: int, expressions: int, test_expressions: int, seed: int) -> Draw:
    """The draw with this number of the ordered pair; depends on nothing but its arguments."""
    entropy = [seed, zlib.crc32(source.encode()), zlib.crc32(target.encode()), number]
    order = np.random.default_rng(np.random.SeedSequence(entropy)).permutation(expressions).tolist()
    return Draw(number, tuple(sorted(order[:test_expressions])), tuple(order[test_expressions:]))


def check_counts(
    expressions: int, test_expressions: int, n_examples: int | Sequence[int], where: str = "study."
) -> None:
    """Raises InvalidInput where the dataset has too few expressions; where: what precedes the settings' names."""
    available = expressions - test_expressions
    counts = [n_examples] if isinstance(n_examples, int) else n_examples
    if max(counts) > available:
        fitting = [count for count in counts if count <= available]
        fitting = fitting or [count for count in (available,) if count > 0]
        fewer = f"{where}n_examples={available}"
        if not isinstance(n_examples, int):
            fewer = f"'{where}n_examples=[{','.join(map(str, fitting))}]'"
        ask = f"Ask for fewer: {fewer}" if fitting else "Hold out fewer"
        raise InvalidInput(
            f"{where}n_examples: {max(counts)} examples asked for, but the dataset has {expressions} expressions, "
            f"of which {test_expressions} are held out for the test ({where}test_expressions), so at most "
            f"{max(available, 0)} are left. {ask}, or use a dataset with more expressions."
        )
