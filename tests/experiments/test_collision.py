"""The study of lip collisions on blocks with a mouth."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from rich.console import Console

from experiments.catalogue import MethodMaker, composed
from experiments.collision import CollisionStudy, chosen_pairs, collide, deepest
from experiments.lip_depth import LipDepth
from experiments.run import only_method
from reports.collision_sheet import Case
from reports.section import section
from retarget.check import InvalidInput
from retarget.types import Pair
from tests.conformance.box import heads_are_boxes
from tests.experiments.block import block

METHOD = MethodMaker.of("anacondar")
SETTINGS = {
    "name": "collision",
    "title": "Lips",
    "description": "",
    "seed": 0,
    "n_examples": 4,
    "pairs": 1,
    "expressions": 4,
    "depth": 0.1,
    "shown": 1,
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the study leaves behind."""
    folder = tmp_path_factory.mktemp("collision")
    with heads_are_boxes(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("reports.collision_sheet.SIZE", (96, 72))
        collide(
            CollisionStudy.from_config(SETTINGS),
            METHOD,
            block(),
            1,
            folder,
            Console(file=io.StringIO()),
        )
    return folder


def test_expressions_that_cross_are_found_and_parted(folder: Path) -> None:
    cases, summary = pd.read_csv(folder / "cases.csv"), pd.read_csv(folder / "summary.csv")
    odd = cases["expression"].str[-3:].astype(int) % 2
    assert len(cases) > 0
    assert odd.all()  # those whose lower lip passes the upper one
    assert (cases["depth_before_mm"] > 0.5).all()
    assert (cases["depth_after_mm"] < 0.3 * cases["depth_before_mm"]).all()
    everything = summary.set_index("pair").loc["all"]
    assert everything["expressions"] == 4
    assert everything["crossing"] == len(cases)
    assert everything["depth_before_max_mm"] == pytest.approx(cases["depth_before_mm"].max())


def test_what_parts_lips_is_felt_less_with_distance(folder: Path) -> None:
    spread = pd.read_csv(folder / "propagation.csv").groupby("from_mm")["moved_mean_mm"].mean()
    assert spread.iloc[0] > 3 * spread.iloc[-1]


def test_the_page_is_a_pdf(folder: Path) -> None:
    assert (folder / "collision.pdf").read_bytes().startswith(b"%PDF")


def test_the_depth_is_how_far_a_lip_was_pushed_into_the_other() -> None:
    data = block()
    neutral = data.neutral("a")
    depth = LipDepth(neutral, data.faces, data.regions)
    assert depth(neutral).max() == 0
    lower, upper = data.regions.vertices["lower_lip"], data.regions.vertices["upper_lip"]
    pushed = neutral.copy()
    pushed[np.setdiff1d(lower, upper), 1] += 1.6  # the gap is 1 mm
    assert depth(pushed).max() == pytest.approx(0.6, abs=0.15)
    parted = neutral.copy()
    parted[np.setdiff1d(lower, upper), 1] -= 1.6
    assert depth(parted).max() == 0


def test_the_section_of_a_cube_is_a_square() -> None:
    data = block()
    segments = section(data.neutral("a"), data.faces, 29.3)  # beside the mouth
    assert np.abs(segments[..., 0]).max() <= 20.0
    corners = {(0.0, 0.0), (0.0, 56.0), (20.0, 0.0), (20.0, 56.0)}  # (z, y)
    ends = {tuple(np.round(point, 9)) for point in segments.reshape(-1, 2)}
    assert corners <= ends | corners  # the back is open
    assert {point for point in corners if point[0] == 20.0} <= ends
    front = segments[(segments[..., 0] > 19.999).all(axis=1)]
    assert np.linalg.norm(front[:, 0] - front[:, 1], axis=1).sum() == pytest.approx(56.0)


def test_pairs_begin_with_neighbours_so_that_everybody_is_a_target() -> None:
    assert chosen_pairs("abc", 4) == [("a", "b"), ("b", "c"), ("c", "a"), ("a", "c")]
    assert len(chosen_pairs("abc", 99)) == 6
    with pytest.raises(InvalidInput, match="at least 2"):
        chosen_pairs("a", 1)


def test_the_page_shows_the_deepest_of_each_pair_first() -> None:
    empty = np.empty((0, 3))
    pair = Pair(np.empty((0, 3), np.int64), empty, empty)
    rows = [("a", "b", 3.0), ("a", "b", 2.0), ("b", "a", 1.0)]
    cases = [
        Case({"source": s, "target": t, "depth_before_mm": d}, pair, empty, empty, 0, empty[:, 0]) for s, t, d in rows
    ]
    assert [case.row["depth_before_mm"] for case in deepest(cases, 2)] == [3.0, 1.0]
    assert [case.row["depth_before_mm"] for case in deepest(cases, 9)] == [3.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"pairs": 0}, "study.pairs: expected a whole number of at least 1"),
        ({"expressions": 2.5}, "study.expressions"),
        ({"depth": 0}, "study.depth: expected a positive"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        CollisionStudy.from_config(SETTINGS | change)


@pytest.mark.parametrize(
    ("method", "message"),
    [("anacondar,plbs", "shows one method, got anacondar, plbs"), ("plbs", "setting 'collisions', got plbs")],
)
def test_a_study_of_one_method_says_which_it_cannot_show(method: str, message: str, tmp_path: Path) -> None:
    config = composed("run", ["study=collision", f"method=[{method}]"])

    def collided() -> None:
        collide(
            CollisionStudy.from_config(SETTINGS), only_method(config), block(), 1, tmp_path, Console(file=io.StringIO())
        )

    with pytest.raises(InvalidInput, match=message):
        collided()


def test_settings_of_the_command_line_reach_the_method() -> None:
    made = only_method(composed("run", ["study=collision", "method.anacondar.w_target=3.5"]))(collisions=True)
    assert (vars(made)["w_target"], vars(made)["collisions"]) == (3.5, True)
