"""Settings of rows: said in full once, and then what differs."""

from dataclasses import replace
from pathlib import Path

from reports.load import load
from reports.tables import setting_rows
from tests.reports.example_study import write_example_study


def test_a_variant_is_told_by_what_differs_from_the_row_above(tmp_path: Path) -> None:
    write_example_study(tmp_path / "study")
    (study,) = load([tmp_path / "study"])
    settings = {"_target_": "a.B", **dict.fromkeys("abcdef", 1.0)}
    told = (settings, settings | {"c": 2.0}, settings | dict.fromkeys("abc", 3.0))
    methods = [m | {"settings": s} for m, s in zip(study.facts["methods"], told, strict=False)]
    changed = replace(study, facts={**study.facts, "methods": methods})
    rows = [row["settings"] for row in setting_rows(changed)]
    assert rows[0] == [f"{name} = 1.0" for name in "abcdef"]
    assert rows[1] == [f"as {study.methods[0].label}, but c = 2.0"]
    assert rows[2] == [f"{name} = {3.0 if name in 'abc' else 1.0}" for name in "abcdef"]
