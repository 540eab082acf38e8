"""The head data, fetched once through the ordinary code path into the user's cache."""

from __future__ import annotations

import pytest

from retarget.types import FloatArray, Regions
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import Identity, IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.targets import Targets, load_head


@pytest.fixture(scope="session")
def base() -> tuple[BaseHead, Targets, Regions]:
    return (*load_head(), load_regions())


@pytest.fixture(scope="session")
def sampler(base: tuple[BaseHead, Targets, Regions]) -> IdentitySampler:
    return IdentitySampler(*base)


@pytest.fixture(scope="session")
def people(base: tuple[BaseHead, Targets, Regions], sampler: IdentitySampler) -> list[tuple[Identity, FloatArray]]:
    """Four identities with their rigs (51, n, 3)."""
    return [(identity, personal_rig(identity, *base)) for identity in map(sampler, range(4))]
