"""Every measure that a table can name is said in words, from the comments of its metric's YAML."""

from __future__ import annotations

import re
from pathlib import Path

import experiments.metrics
from experiments.catalogue import options, sentence
from experiments.correspondence import CORRESPONDENCES
from experiments.glossary import glossary, measures
from synth_data.weights import SOURCES

SOURCE = Path(experiments.metrics.__path__[0])


def test_every_measurement_of_every_metric_has_its_sentence() -> None:
    """The names are read from the source: the first argument of every Measurement that a metric makes."""
    named = {
        name
        for path in SOURCE.glob("*.py")
        for name in re.findall(r'Measurement\(f?"(\w+?)(?:_\{name\})?"', path.read_text(encoding="utf-8"))
    }
    said = measures()
    assert len(named) > 15
    for name in named:
        assert any(measure == name or measure.startswith(f"{name}_") for measure in said), name
    assert {"vertex_l2_mean", "vertex_l2_p95", "vertex_l2_max", "signed_error_x", "signed_error_z"} <= set(said)


def test_a_glossary_holds_what_it_is_asked_for() -> None:
    made = glossary(["seam_excess", "own_metric"], {"seam_excess": "zero"}, ["weights sparse", "weights mine"])
    assert made["measures"]["seam_excess"]["better"] == "zero"
    assert made["measures"]["seam_excess"]["says"].startswith("jump of the error across borders")
    assert made["measures"]["own_metric"] == {"says": "", "better": ""}
    assert set(made["conditions"]) == {"weights sparse"}
    assert made["regions"]["borders"] == "edges of the mesh that join two patches of plbs"


def test_every_condition_is_said_in_words() -> None:
    names = [f"weights {name}" for name in SOURCES] + [f"correspondence {name}" for name in CORRESPONDENCES]
    assert list(glossary([], {}, names)["conditions"]) == names


def test_the_sentence_of_a_metric_stays_its_first_comment() -> None:
    assert all(sentence("metric", name).endswith(".") for name in options("metric"))
    assert measures()["edge_deviation"].startswith("mean difference")  # its own line, not the metric's sentence
