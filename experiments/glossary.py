"""What the measures, regions and conditions in a study's tables are, each in a sentence, for who reads the report.

The sentences on a measure are indented comments of its metric's YAML, ``#   NAME: words``, and so are those on a region
that only this metric has, ``#   region NAME: words``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from experiments.catalogue import CONF, options, sentence

REGIONS: Mapping[str, str] = {  # of `Regions`, and what metrics make of them
    "head": "all visible skin, without mouth cavity and eye sockets",
    "face": "hairline to jaw line, without ears",
    "lips": "vermilion border to wet lip",
    "upper_lip": "vermilion border to wet lip, above",
    "lower_lip": "vermilion border to wet lip, below",
    "lip_contour": "the closed line of the outer vermilion border",
    "mouth": "between the lines where the lips meet",
    "eyes": "lids and the skin about them; of apertures the mean of both eyes, of lids that cross the worse eye",
    "eye_left": "lids of the left eye and the skin about them",
    "eye_right": "lids of the right eye and the skin about them",
    "eye_opening_left": "between the lid margins of the left eye",
    "eye_opening_right": "between the lid margins of the right eye",
    "brows": "skin that carries the eyebrows",
    "cheeks": "socket to jaw, nasolabial fold to ear",
    "nose": "root to base, with the alae",
    "jaw": "chin and jaw line below the lips",
    "ears": "from the root of the ear outward",
    "neck": "below jaw line and nape",
    "all": "the whole mesh",
    "tissue": "the soft tissue between skin and bone of the simulated head",
}
_CONDITIONS: Mapping[str, str] = {
    "weights recombined": "each region of the face takes its blending weights from another moment of a recording, "
    "with gestures on top",
    "weights recorded": "blending weights are frames of a recording",
    "weights sparse": "blending weights of few drawn gestures at a time",
    "correspondence given": "for each example of the target the source's own expression is known",
    "correspondence embedded": "the source's counterparts of the examples are found by placing them among its "
    "animation (section 3.5 of the paper)",
    "correspondence ebfr": "the source's counterparts of the examples are made by EBFR",
    "correspondence paper": "the source's counterparts of the examples are embedded for AnaConDaR and made by EBFR for "
    "all others (section 4.2.1 of the paper)",
}
_LINE = re.compile(r"#\s{2,}(?:(region) )?(\w+): (.+)")


def measures() -> dict[str, str]:
    """The sentence on every measure by its name in tables; one with its metric's name has the metric's own."""
    own = {name: sentence("metric", name).rstrip(".") for name in options("metric")}
    return own | {name: words for kind, name, words in _lines() if not kind}


def regions() -> dict[str, str]:
    """The sentence on every region by its name in tables."""
    return {**REGIONS, **{name: words for kind, name, words in _lines() if kind}}


def glossary(metrics: Iterable[str], directions: Mapping[str, str], conditions: Iterable[str]) -> dict[str, Any]:
    """What a study's tables name: measures with what is better, regions, and those conditions that need words.

    directions: "lower", "higher" or "zero" by measure. conditions: like "weights sparse".
    """
    known = measures()
    return {
        "measures": {name: {"says": known.get(name, ""), "better": directions.get(name, "")} for name in metrics},
        "regions": regions(),
        "conditions": {name: _CONDITIONS[name] for name in conditions if name in _CONDITIONS},
    }


def _lines() -> list[tuple[str, str, str]]:
    """(kind, name, words) of all metrics, in the order of their names."""
    texts = ((CONF / "metric" / f"{name}.yaml").read_text(encoding="utf-8") for name in options("metric"))
    return [
        (found[1] or "", found[2], found[3])
        for text in texts
        for line in text.splitlines()
        if (found := _LINE.match(line))
    ]
