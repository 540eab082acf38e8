"""The report as one HTML page: its tables and plots, and the heads as a viewer that turns. It needs no network.

Tables and plots hold what the PDF prints (`reports.report.describe`), the viewer the frames that the study kept.
Scripts, styles, plots and meshes are inside the page, and its content security policy lets nothing else in. The same
results give the same bytes.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from matplotlib.colors import to_hex

from reports import page_tables as tables
from reports.colors import ERROR_COLORMAP, SKIN
from reports.html_head import HEAD
from reports.load import StudyResults
from reports.page_claims import claims_part
from reports.page_heads import ASPECT, BUDGET, STEP, Packed, pack_heads
from reports.page_lists import named_list, plain_list
from retarget.io.files import write_whole

_TEMPLATE, *_SCRIPTS = (Path(__file__).with_name(f"page{name}") for name in (".html", "_viewer.js", "_tables.js"))


def write_page(path: Path, content: Mapping[str, Any], studies: Sequence[StudyResults], work: Path) -> Path:
    """Write the page of some studies, whole or not at all; returns its path.

    `content` is what `reports.report.alone` made of the same studies, `work` the folder with its plots. Raises
    InvalidInput where the page cannot be written.
    """
    text = page(content, studies, work)
    write_whole(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    return path


def page(content: Mapping[str, Any], studies: Sequence[StudyResults], work: Path) -> str:
    """The page as text; see `write_page`."""
    several = len(content["studies"]) > 1
    box = _plot(work / content["box"], _BOX_SEVERAL if several else _BOX)
    sections = [list(_sections(study, content["memory"], work, "" if several else box)) for study in content["studies"]]
    heads = list(_heads(content, studies))
    arrays = [array for packed in heads for array in packed.arrays]
    facts = {
        "skin": SKIN,
        "colors": [to_hex(ERROR_COLORMAP(x)) for x in np.linspace(0, 1, 11)],
        "studies": [packed.facts for packed in heads],
    }
    return Template(_TEMPLATE.read_text(encoding="utf-8")).substitute(
        head=HEAD,
        title=escape(content["title"]),
        description=escape(content["description"]),
        links=_links(_labels(content), sections, bool(heads)),
        overview=_overview(content["overview"], work, box) if content["overview"] else "",
        viewer_hidden="" if heads else "hidden",
        no_viewer="" if heads else _NO_FRAMES,
        aspect=f"{ASPECT[0]} / {ASPECT[1]}",
        precision=f"{STEP:g}",
        correspondences=_correspondences(content["correspondences"]),
        studies="".join(map(_study, range(len(sections)), _labels(content), sections)),
        glossary=_glossary(content["glossary"]),
        claims=claims_part(content["claims"]),
        limits=named_list(content["limits"]),
        heads=json.dumps(facts, ensure_ascii=True).replace("</", "<\\/").replace("<!--", "<\\u0021--"),
        arrays="".join(f'<script type="text/plain" id="array-{i}">{text}</script>\n' for i, text in enumerate(arrays)),
        script="".join(script.read_text(encoding="utf-8") for script in _SCRIPTS),
    )


_FOUND = "What was found"
_LAST = (("measures", "Measures and regions"), ("claims", "Published claims"), ("limits", "What this cannot show"))
_BOX = (
    "Errors grouped by the number of target examples, in the form of Fig. 10 of the paper. One dot per ordered pair "
    "(mean over draws and expressions); boxes hold the middle half, whiskers reach 1.5 times its width. Logarithmic: "
    "equal distances are equal ratios."
)
_BOX_SEVERAL = (
    "Errors under each condition, in the form of Fig. 10 of the paper. One dot per ordered pair (mean over draws and "
    "expressions); boxes hold the middle half. Logarithmic. Compare the order of rows between colours."
)
_ORDER = (
    "Mean of the primary metric with its nominal 95 % interval under each condition, logarithmic. The row with the "
    "smallest rank on average is on top, rows that are no method are at the bottom. exact: rounding alone."
)
_EXAMPLES = (
    "Effect of the number of examples: mean and 95 % interval of one method per plot, all others in grey, logarithmic. "
    "A flat line does not learn from examples."
)
_NO_FRAMES = (
    "<h2>Heads</h2><p>This study kept no frames, so there are no heads to turn. "
    "Set <code>study.figures.pairs</code> to 1 or more to keep some.</p>"
)


def _heads(content: Mapping[str, Any], studies: Sequence[StudyResults]) -> Iterator[Packed]:
    """The heads of every study that kept some; they share the room."""
    first, budget = 0, BUDGET // len(studies)
    for study, said in zip(studies, content["studies"], strict=True):
        limit = said["heads"]["limit_mm"] if said["heads"] else 1.0
        if packed := pack_heads(study, limit, first, budget):
            first += len(packed.arrays)
            yield packed


def _plot(path: Path, caption: str) -> str:
    """A figure of the report below its caption. As an image it runs no script and shares no names with the page."""
    data, words = base64.b64encode(path.read_bytes()).decode(), escape(caption)
    return (
        f'<p class="muted caption">{words}</p><div class="wide plot" tabindex="0" role="region" aria-label="{words}">'
        f'<img src="data:image/svg+xml;base64,{data}" alt="{words}"></div>\n'
    )


def _overview(overview: Mapping[str, Any], work: Path, box: str) -> str:
    favours = [(f"{name}.", text) for name, text in overview["favours"]]
    parts = "".join(tables.ordering_table(overview["conditions"], part) for part in overview["parts"])
    agreement = tables.agreement_table(
        overview["counts"],
        overview["agreement"],
        "Agreement of two orders: Kendall's tau of the means of all methods and controls, 1 for the same order.",
    )
    return (
        f"<section><h2>The order of methods</h2>{plain_list(overview['findings'])}"
        f"{_plot(work / overview['plot'], _ORDER)}{box}<h3>What each condition favours</h3>{named_list(favours)}"
        f"<h3>Conditions side by side</h3>{parts}{agreement}"
        "<p class='muted'>Ranks are of means alone: a rank apart is no difference between methods, which the tests of "
        "each condition state.</p></section>"
    )


def _correspondences(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return ""
    caption = (
        "The same method against itself with the source's true counterparts of the examples: ratio of the primary "
        "metric, and how often the error is smaller."
    )
    return (
        "<section><h2>Other source examples against given ones</h2>"
        f"{tables.correspondence_table(rows, caption)}</section>"
    )


def _glossary(glossary: Mapping[str, Any]) -> str:
    caption = f"The measures by their names in tables; better: lower, higher, or nearer to 0. {glossary['signed']}"
    named = [(f"{name}:", f"{said}.") for name, said in (*glossary["regions"], *glossary["conditions"])]
    return tables.glossary_table(glossary["measures"], caption) + (named_list(named) if named else "")


def _labels(content: Mapping[str, Any]) -> list[str]:
    """Of each study, where there are several."""
    studies = content["studies"]
    return [str(study["label"]) if len(studies) > 1 else "" for study in studies]


def _study(number: int, label: str, sections: Sequence[tuple[str, str]]) -> str:
    name = f" <small>{escape(label)}</small>" if label else ""
    body = "".join(
        f'<section id="{_anchor(number, title)}"><h2>{escape(title)}{name}</h2>\n{text}</section>\n'
        for title, text in sections
    )
    return f'<article aria-label="{escape(label) or "results"}">\n{body}</article>\n'


def _anchor(number: int, title: str) -> str:
    return f"{title.lower().replace(' ', '-')}-{number}"


def _links(labels: Sequence[str], sections: Sequence[Sequence[tuple[str, str]]], heads: bool) -> str:
    """To the sections, or to the studies where there are several."""
    if len(labels) > 1:
        targets = [(_anchor(i, _FOUND), label) for i, label in enumerate(labels)]
    else:
        targets = [(_anchor(0, title), title) for title, _ in sections[0]]
    targets = [("viewer", "Heads")] * heads + targets + [*_LAST]
    links = (f'<a href="#{anchor}">{escape(title)}</a>' for anchor, title in targets)
    return f"<nav>{''.join(links)}</nav>"


def _sections(study: Mapping[str, Any], memory: str, work: Path, box: str) -> Iterator[tuple[str, str]]:
    """(title, body) of each section; `box` is the box plot of a page of one study."""
    counts, reference = study["counts"], study["reference"]
    yield (
        _FOUND,
        f"<p class='muted'>Every statement holds for: {escape(study['conditions'])}.</p>{plain_list(study['findings'])}"
        + (f"<p><em>{escape(study['favours'])}</em></p>" if study["favours"] else ""),
    )
    pairs = " or ".join(map(str, study["pairs"]))
    related = any(cell["ratio"] for row in study["summary"] for cell in row["cells"])
    ratios = f", and the geometric-mean ratio to {reference}" if related else ""
    yield (
        "Errors",
        tables.summary_table(
            counts,
            study["summary"],
            f"{_measure(study)}: mean over {pairs or 'no'} ordered pairs with its nominal 95 % interval{ratios}. Bold: "
            "smallest mean of a method or control. A mean covers only cells that all compared methods finished; how "
            "many of its own cells have no result stands after it.",
        )
        + box
        + (_plot(work / study["examples"], _EXAMPLES) if study["examples"] else ""),
    )
    if study["tables"]:
        yield (
            "Further measures",
            "".join(
                tables.summary_table(
                    counts, also["summary"], f"{_measure(also)}, in the manner of the table of errors."
                )
                for also in study["tables"]
            ),
        )
    if study["measures"]:
        caption = f"Each row against {reference}: above 1 the row is worse. Uncorrected; no claim rests on it."
        measures = tables.measures_table(study["measures"], reference, caption)
        yield "What each row was meant to change", measures
    yield (
        "Errors by region",
        "".join(map(tables.region_table, study["regions"]))
        + f"<p class='muted'>Mean of {escape(study['metric'])} in {escape(study['unit'])}. "
        + _bold(
            study,
            f"the difference to {escape(reference)} is below 5 % after Benjamini-Hochberg; secondary, no claim "
            "rests on it.",
        )
        + "</p>",
    )
    ratios = f"Ratios to {reference}: a dot per pair, diamond and bar for the geometric mean and its 95 % interval."
    yield "Tests", _tests(study) + (_plot(work / study["ratio"], ratios) if study["ratio"] else "")
    yield "Cells without a clean result", _failures(study)
    times = (
        f"Medians with quartiles in the same unit. The largest process took {memory} MB, whatever methods it had run "
        "before. Times were taken beside other processes: orders of magnitude, no small differences."
    )
    yield "Times", tables.times_table(counts, study["times"], times)
    if study["everything"]:
        yield "Every measure", tables.everything_table(study["everything"])
    yield "Methods", tables.settings_table(study["settings"])
    facts = "".join(f"<dt>{escape(name)}</dt><dd>{escape(value)}</dd>" for name, value in study["facts"])
    yield "What was run", f"<dl>{facts}</dl>"


def _tests(study: Mapping[str, Any]) -> str:
    family, reference = study["family"], study["reference"]
    if not study["tests"]:
        primary = "<p>No method of the primary family could be compared.</p>"
    else:
        caption = (
            f"Primary family against {reference}: {_measure(study)}. Holm's correction is over the declared family of "
            f"{family['declared']} tests."
        )
        if family["run"] < family["declared"]:
            caption += f" Family incomplete: {family['run']} of {family['declared']} tests."
        caption += " " + _bold(study, "below 5 %.")
        primary = tables.tests_table(study["tests"], "p Holm, primary", caption)
    caption = "Methods outside the primary family, with Benjamini-Hochberg's correction; no claim rests on them."
    secondary = tables.tests_table(study["secondary"], "q BH", caption) if study["secondary"] else ""
    return (
        f"{primary}{secondary}<p class='muted'>A difference is claimed where the corrected test, the tests on sources "
        "and on targets and the interval agree. p naive takes every expression as independent, which overstates the "
        "evidence.</p>"
    )


def _bold(study: Mapping[str, Any], meaning: str) -> str:
    """What bold print means in a table of tests."""
    return str(study["no_claim"]) or f"Bold: {meaning}"


def _failures(study: Mapping[str, Any]) -> str:
    said = tables.status_table(study["statuses"]) if study["statuses"] else ""
    caption = "Solves, one per expression, that stopped at their iteration limit or failed."
    solves = tables.solves_table(study["solves"], caption) if study["solves"] else ""
    return said + solves or f"<p>All {study['cells']} cells finished.</p>"


def _measure(study: Mapping[str, Any]) -> str:
    unit = "" if study["unit"] == "1" else f" in {study['unit']}"
    return f"{study['metric']} on region {study['region']}{unit}"
