"""The picture that a person checks after a transfer of regions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from reports import regions_sheet as sheet
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head


def test_the_sheet_shows_each_loop_and_leaves_out_what_is_not_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sheet, "SIZE", (112, 132))
    monkeypatch.setattr(sheet, "WIDE", (90, 104))
    base, _ = load_head()
    regions = load_regions()
    without = {name: loop for name, loop in regions.loops.items() if name != "lid_margin_left"}
    sheet.regions_sheet(tmp_path / "check.png", base.vertices, base.faces, replace(regions, loops=without, patches={}))
    picture = np.asarray(Image.open(tmp_path / "check.png").convert("RGB")).astype(int)
    height, width = picture.shape[:2]
    row = picture[int(0.38 * height) : int(0.55 * height), width // 4 :].reshape(-1, 3)  # loops, without the legend

    def shown(color: str) -> int:
        return int((np.abs(row - 255 * np.array(to_rgb(color))).max(axis=1) < 3).sum())

    assert all(shown(color) > 100 for color in sheet.COLORS[: len(without) - 1])  # the neck is not drawn
    assert shown(sheet.COLORS[len(without) - 1]) == 0
