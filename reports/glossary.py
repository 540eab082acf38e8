"""What the tables of some studies name: measures, regions and conditions in words, each once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from reports.load import StudyResults

_BETTER = {"zero": "nearer to 0"}
SIGNED = (
    "A measure that is better nearer to 0 can be negative: it has no ratio where a value is below 0, and no smallest "
    "mean in bold where a mean is."
)


def merged_glossary(studies: Sequence[StudyResults]) -> dict[str, Any]:
    """{measures: [{name, unit, better, says}], regions: [(name, words)], conditions: [(name, words)], signed}.

    Names are those that the studies measured, in their order; words are empty, and regions and conditions left out,
    where a study was written without them.
    """
    measures: dict[str, dict[str, str]] = {}
    regions: dict[str, str] = {}
    conditions: dict[str, str] = {}
    for study in studies:
        said = study.facts.get("glossary", {})
        for name in study.summary["metric"].unique():
            known = said.get("measures", {}).get(name, {"says": "", "better": ""})
            if not measures.get(name, {}).get("says"):
                better = _BETTER.get(known["better"], known["better"])
                unit = study.unit_of(name)
                row = {"name": name, "unit": "" if unit == "1" else unit, "better": better, "says": known["says"]}
                measures[name] = row
        taken = study.summary["region"].unique()
        regions |= {name: words for name, words in said.get("regions", {}).items() if name in taken}
        conditions |= said.get("conditions", {})
    signed = any(row["better"] == _BETTER["zero"] for row in measures.values())
    return {
        "measures": list(measures.values()),
        "regions": list(regions.items()),
        "conditions": list(conditions.items()),
        "signed": SIGNED if signed else "",
    }
