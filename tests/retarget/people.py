"""Two people on the MakeHuman head, and what they do."""

from __future__ import annotations

from functools import lru_cache

from retarget.types import Examples, FloatArray, Pair
from synth_data.dataset import Dataset
from synth_data.makehuman.dataset import MakeHuman

SOURCE, TARGET = "person-000", "person-001"
SHOWN = 12  # expressions


@lru_cache(maxsize=1)
def people() -> Dataset:
    return MakeHuman(
        identities=2, first_seed=0, subdivisions=0, expressions=SHOWN, truth="personal_blendshapes", weights="sparse"
    ).load()


def pair(source: str = SOURCE, target: str = TARGET) -> Pair:
    data = people()
    return Pair(data.faces, data.neutral(source), data.neutral(target), data.regions)


def frames(identity: str) -> FloatArray:
    """(12, n, 3) mm."""
    return people().frames(identity, range(SHOWN))


def examples(count: int, source: str = SOURCE, target: str = TARGET) -> Examples:
    """The first `count` expressions."""
    return Examples(frames(target)[:count], frames(source)[:count])
