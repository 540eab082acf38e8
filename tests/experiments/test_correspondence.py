"""`study.correspondence`: what stands for the source's counterparts of the target's examples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from experiments.catalogue import make_method, method_settings
from experiments.correspondence import CORRESPONDENCES, EmbeddingSettings, Known, RiggingSettings, correspondences
from experiments.metrics.metric import Metric
from experiments.metrics.vertex_l2 import VertexL2
from experiments.plan import plan
from experiments.study import Study
from retarget.check import InvalidInput
from retarget.rig.deformation_transfer import DeformationTransfer
from retarget.types import FloatArray, Pair
from tests.experiments.test_study_run import CONFIG, EMBEDDING, PLBS, run
from tests.experiments.toy import toy

RIGGING: dict[str, Any] = {
    "beta_first": 0.25,
    "beta_last": 0.05,
    "alternations": 2,
    "bounded": False,
    "lambda_reg": 0.01,
}
RIGGING |= {"deformation_transfer": "area"}
EMBED = EmbeddingSettings.from_config(EMBEDDING)
RIG = RiggingSettings.from_config(RIGGING)
DATA = toy()
PAIR = Pair(DATA.faces, DATA.neutral("a"), DATA.neutral("b"), DATA.regions)
SOURCE, TARGET = (DATA.frames(name, range(40)) for name in "ab")
METRIC: dict[str, tuple[Metric, dict[str, Any]]] = {"vertex_l2": (VertexL2(["mean"], ["head"]), {})}


def known(indices: Sequence[int], method: str = "plbs", animation: FloatArray = SOURCE, span: str = "all") -> Known:
    i = list(indices)
    names = tuple(DATA.expressions[j] for j in i)
    return Known(names, SOURCE[i], TARGET[i], animation, span, make_method(method))


def distance(found: FloatArray | None, indices: Sequence[int]) -> float:
    """mm, mean over vertices"""
    assert found is not None
    return float(np.linalg.norm(found - SOURCE[list(indices)], axis=-1).mean())


def test_the_sources_animation_makes_rigged_examples_better_than_deformation_transfer_alone() -> None:
    few = range(3, 11)
    rigged = correspondences(PAIR, ["ebfr"], None, RIG)["ebfr"]
    found = rigged(known(few))
    back = DeformationTransfer.of(Pair(PAIR.faces, PAIR.target_neutral, PAIR.source_neutral, PAIR.regions), "area")
    assert distance(found.examples, few) < 0.9 * distance(back(TARGET[list(few)]), few)
    assert len(found.solves) == len(few)
    assert found.seconds > 0
    none = rigged(known(few, animation=SOURCE[:0], span="none"))
    np.testing.assert_array_equal(none.examples, back(TARGET[list(few)]))


def test_a_target_equal_to_the_source_gets_nearly_its_own_examples() -> None:
    twins = replace(PAIR, target_neutral=PAIR.source_neutral)
    asked = replace(known(range(8)), target_examples=SOURCE[:8])
    found = correspondences(twins, ["ebfr"], None, RIG)["ebfr"](asked)
    moved = np.linalg.norm(SOURCE[:8] - PAIR.source_neutral, axis=-1).mean()
    assert distance(found.examples, range(8)) < 0.05 * moved


def test_a_set_of_examples_is_rigged_once_for_all_methods_and_depends_on_no_other() -> None:
    one, other = (correspondences(PAIR, ["ebfr", "paper"], EMBED, RIG) for _ in range(2))
    first = one["ebfr"](known([3, 4, 5]))
    other["ebfr"](known([5]))
    again = other["ebfr"](known([3, 4, 5]))
    assert first.examples is not None
    assert again.examples is not None
    assert again.examples.tobytes() == first.examples.tobytes()
    assert one["paper"](known([3, 4, 5], "lbs")) is one["ebfr"](known([3, 4, 5], "plbs"))
    assert one["ebfr"](known([])).examples.shape == (0, 642, 3)  # type: ignore[union-attr]


def test_as_published_anacondar_embeds_ebfr_needs_none_and_the_others_are_rigged() -> None:
    made = correspondences(PAIR, CORRESPONDENCES, EMBED, RIG)
    for method, same in {"anacondar": "embedded", "no_anacon": "embedded", "plbs": "ebfr", "lbs": "ebfr"}.items():
        assert made["paper"](known([3, 4], method)) is made[same](known([3, 4], method)), method
    assert made["paper"](known([3, 4], "ebfr")).examples is None
    assert list(made) == list(CORRESPONDENCES)


def test_examples_that_do_not_move_and_missing_settings_are_refused() -> None:
    still = replace(known([3, 4]), target_examples=np.repeat(PAIR.target_neutral[None], 2, axis=0))
    with pytest.raises(InvalidInput, match="none of the target's examples differs from its neutral"):
        correspondences(PAIR, ["ebfr"], None, RIG)["ebfr"](still)
    with pytest.raises(InvalidInput, match=r"study.rigging: expected settings"):
        correspondences(PAIR, ["ebfr"], EMBED, None)
    with pytest.raises(InvalidInput, match=r"study.embedding: expected settings"):
        correspondences(PAIR, ["paper"], None, RIG)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"bete_first": 1}, "study.rigging: 'bete_first' is unknown, .* Did you mean 'beta_first'"),
        ({"beta_first": 0}, "beta_first: expected a positive number"),
        ({"deformation_transfer": "aria"}, "study.rigging.deformation_transfer: 'aria' is unknown"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        Study.from_config(CONFIG | {"correspondence": "ebfr", "rigging": {**RIGGING, **change}})


def test_all_stand_side_by_side_in_a_study(tmp_path: Path) -> None:
    config = CONFIG | {"correspondence": list(CORRESPONDENCES), "embedding": EMBEDDING, "rigging": RIGGING}
    study = Study.from_config(config | {"reference": "plbs", "draws": 1, "n_examples": [5]})
    rows = study.rows({"plbs": PLBS, "ebfr": {**method_settings("ebfr"), "alternations": 1}})
    metrics, cells = run(plan(study, toy(2), rows, METRIC, tmp_path))
    assert set(cells["status"]) == {"ok"}
    error = metrics[metrics["method"] == "plbs"].groupby("correspondence")["value"].mean()
    assert error["given"] < error["ebfr"]
    assert error["ebfr"] == error["paper"]
    seconds = cells[cells["method"] == "ebfr"].groupby("correspondence")["correspondence_seconds"].max()
    assert seconds["paper"] == 0 < seconds["ebfr"]
