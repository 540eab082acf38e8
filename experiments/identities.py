"""Which identities a study may use: those that settings are tuned on, and those that methods are compared on."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from retarget.check import InvalidInput

FIRST_TUNING_SEED = 1000  # tuning starts here, all other studies end before


def check_identities(dataset: Mapping[str, Any], *, tuning: bool) -> None:
    """Of a dataset's settings, where it makes its identities from seeds.

    Raises InvalidInput for tuning on identities that a study may use, and for a study on those that may be tuned on.
    """
    first, count = (dataset.get(name) for name in ("first_seed", "identities"))
    if not isinstance(first, int) or not isinstance(count, int):
        return
    if tuning and first < FIRST_TUNING_SEED:
        raise InvalidInput(
            f"dataset.first_seed: expected at least {FIRST_TUNING_SEED} for tuning, got {first}. Smaller seeds are the "
            "identities that settings are tested on."
        )
    if not tuning and first + count > FIRST_TUNING_SEED:
        raise InvalidInput(
            f"dataset.first_seed: expected identities below {FIRST_TUNING_SEED}, got {first} to {first + count - 1}. "
            "On larger seeds settings are tuned: results on them would flatter the tuned methods."
        )
