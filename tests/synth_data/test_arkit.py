"""ARKit's names."""

from __future__ import annotations

from synth_data.arkit import LIVE_LINK, MIRRORED, NAMES, SKIN_NAMES


def test_counts() -> None:
    assert len(set(NAMES)) == len(NAMES) == 52
    assert len(SKIN_NAMES) == 51


def test_mirroring_is_an_involution_that_swaps_twenty_pairs() -> None:
    assert all(MIRRORED[MIRRORED[name]] == name for name in NAMES)
    assert sum(MIRRORED[name] != name for name in NAMES) == 40
    assert MIRRORED["jawLeft"] == "jawRight"
    assert MIRRORED["jawOpen"] == "jawOpen"


def test_live_link_names() -> None:
    assert LIVE_LINK["eyeBlinkLeft"] == "EyeBlinkLeft"
    assert len(set(LIVE_LINK.values())) == 52
