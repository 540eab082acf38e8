"""The diagram of the methods: words lie inside their boxes, boxes beside each other."""

from __future__ import annotations

import itertools
from pathlib import Path

import matplotlib
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from reports.figures import STYLE, WIDTH
from reports.structure import STRUCTURES, Structure, draw, structure_figure


@pytest.mark.parametrize("structure", STRUCTURES, ids=lambda structure: structure.name)
def test_words_fit_their_boxes_and_boxes_are_apart(structure: Structure) -> None:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, 0.9))
        FigureCanvasAgg(figure)
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, WIDTH), ylim=(0.9, 0))
        drawn = draw(axes, structure, 0.0)
        page = figure.bbox
        boxes = [box.get_window_extent() for box, _ in drawn]
        for (_, text), box in zip(drawn, boxes, strict=True):
            words = text.get_window_extent()
            assert box.x0 < words.x0
            assert words.x1 < box.x1
            assert box.y0 < words.y0
            assert words.y1 < box.y1
            assert page.x0 <= box.x0
            assert box.x1 <= page.x1
    for one, other in itertools.combinations(boxes, 2):
        assert not one.overlaps(other)
    assert [text.get_text() for _, text in drawn][-1] == "target\nanimation"


def test_the_diagram_is_repeated(tmp_path: Path) -> None:
    for name in ("one.svg", "two.svg"):
        structure_figure(tmp_path / name)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()
