"""What raters said, as a PDF and as tables: mean ranks with their spread and tests, as in Figs 8 and 11."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from reports.colors import method_color
from reports.figures import WIDTH, canvas
from reports.rankings import RATERS, Rankings
from reports.rankings_statistics import MIN_CLUSTERS, Part, analyse, participant_means, supported
from reports.sheet import Picture, PictureRow, Pictures, Table, write_sheet
from reports.text import bounds, number, p_value
from retarget.io.files import write_whole

_NOT_PEOPLE = {"synthetic": ", a test", "metric": ", no rater"}
_FORMULA = tuple("=+-@\t\r")  # what a spreadsheet would compute instead of show
_COLUMNS = (
    " Interval: of the mean over participants, nominal 95 %. Deviation: of single ranks. First: how often ranked "
    "first. By error: mean rank by vertex error on the same items, a metric that no rater gave."
)


def build_rankings_sheet(rankings: Rankings, folder: Path) -> tuple[Path, Path, Path]:
    """Write <raters>_rankings.pdf, _summary.csv and _participants.csv; returns their paths."""
    parts = analyse(rankings)
    pdf, summary, people = (
        folder / f"{rankings.raters}_rankings{end}" for end in (".pdf", "_summary.csv", "_participants.csv")
    )
    with tempfile.TemporaryDirectory(prefix="rankings-") as name:
        work = Path(name)
        rank_bars(rankings, parts, work / "ranks.svg")
        blocks: list[Pictures | Table] = [
            Pictures(("",), (1.0,), (PictureRow((Picture("ranks.svg"),)),), _figure_caption(rankings)),
            *(_ranks_table(rankings, part) for part in parts),
            _tests_table(rankings, parts),
            _files_table(rankings),
        ]
        write_sheet(pdf, title(rankings), describe(rankings, parts), blocks, work)
    write_whole(summary, lambda temporary: summary_table(rankings, parts).to_csv(temporary, index=False))
    write_whole(people, lambda temporary: participants_table(rankings).to_csv(temporary, index=False))
    return pdf, summary, people


def title(rankings: Rankings) -> str:
    return f"Rankings by {_who(rankings)}{_NOT_PEOPLE.get(rankings.raters, '')}"


def describe(rankings: Rankings, parts: Sequence[Part]) -> str:
    """Who ranked what, from which files, and what follows."""
    key, design = rankings.key, rankings.key.design
    items = len(key.items)
    shown = {"none": "no example of the target", "truth": "the target's own expression"}.get(
        design["target_example"], f"a {design['target_example']} example of the target"
    )
    said = [
        f"{_who(rankings)} ranked {len(key.methods)} methods on {items} items "
        f"({_counts(rankings)} examples, {shown}) of questionnaire {key.id}, study '{key.study}'.",
        f"Asked: {design['question']}",
        *_left_out(rankings),
        *_findings(rankings, parts[0]),
    ]
    if rankings.raters == "synthetic":
        said.insert(0, "A test of the analysis: no person gave these rankings, they say nothing about the methods.")
    if rankings.raters == "metric":
        said.insert(0, "These rankings were computed from a metric: no person gave them.")
    return " ".join(said)


def rank_bars(rankings: Rankings, parts: Sequence[Part], path: Path) -> None:
    """Mean ranks as bars, all items above and each example count below, as in Fig. 8."""
    methods = rankings.key.methods
    below = parts[1:]
    with canvas(path, WIDTH, 4.6 if below else 2.6) as figure:
        rows = figure.add_gridspec(
            2 if below else 1, max(len(below), 1), left=0.075, right=0.995, top=0.93 if below else 0.88,
            bottom=0.17 if below else 0.26, hspace=0.5, wspace=0.08,
        )  # fmt: skip
        first = figure.add_subplot(rows[0, :])
        _bars(first, rankings, parts[0], 0.5 if below else 0.55)
        for column, part in enumerate(below):
            axes = figure.add_subplot(rows[1, column])
            _bars(axes, rankings, part, 0.62, named=False)
            if column:
                axes.tick_params(labelleft=False)
                axes.set_ylabel("")
        handles = [
            Line2D([], [], color=method_color(i), lw=6, label=rankings.key.labels[m]) for i, m in enumerate(methods)
        ] + [
            Line2D([], [], color="#222222", lw=2.2, label="95 % interval of the mean"),
            Line2D([], [], color="#777777", lw=0.8, label="standard deviation of single ranks"),
            Line2D(
                [], [], color="#222222", marker="o", mfc="white", mew=0.5, ms=2.8, lw=0, label="a participant's mean"
            ),
        ]
        figure.legend(handles=handles, loc="lower center", ncols=4, frameon=False, fontsize=7, handlelength=1.4)


def summary_table(rankings: Rankings, parts: Sequence[Part]) -> pd.DataFrame:
    """One row for each part and method, tidy."""
    rows = []
    for part in parts:
        tests = {test.method: asdict(test) for test in part.tests}
        for rank in part.ranks:
            test = {name: value for name, value in tests.get(rank.method, {}).items() if name != "method"}
            rows.append(
                {
                    "raters": rankings.raters,
                    "questionnaire": rankings.key.id,
                    "n_examples": "all" if part.n_examples is None else part.n_examples,
                    "participants": part.participants,
                    "items": part.items,
                    "reference": rankings.key.reference,
                    **asdict(rank),
                    **test,
                }
            )
    return pd.DataFrame(rows)


def participants_table(rankings: Rankings) -> pd.DataFrame:
    """Mean rank of every method by each participant; codes that a spreadsheet would take for a formula are quoted."""
    means = participant_means(rankings.ranks)[list(rankings.key.methods)].reset_index()
    codes = [f"'{code}" if code.startswith(_FORMULA) else code for code in means["participant"]]
    return means.assign(participant=codes, raters=rankings.raters)


def _bars(axes: Axes, rankings: Rankings, part: Part, width: float, named: bool = True) -> None:
    people = participant_means(
        rankings.ranks if part.n_examples is None else rankings.ranks[rankings.ranks["n_examples"] == part.n_examples]
    )
    last = len(rankings.key.methods)
    for i, rank in enumerate(part.ranks):
        axes.bar(i, rank.mean - 1, width, bottom=1, color=method_color(i), alpha=0.85, lw=0)
        values = np.sort(people[rank.method].to_numpy(dtype=np.float64))
        beside = (np.arange(len(values)) * 0.618 % 1 - 0.5) * width * 0.5  # spread evenly, the same every time
        axes.plot(
            i - width * 0.22 + beside * 0.8, values, "o", ms=2.4, mfc="white", mec="#222222", mew=0.4, lw=0, alpha=0.8
        )
        at = i + width * 0.28
        if np.isfinite(rank.spread):
            axes.plot([at, at], [rank.mean - rank.spread, rank.mean + rank.spread], color="#777777", lw=0.8)
        if np.isfinite(rank.low):
            axes.plot([at, at], [rank.low, rank.high], color="#222222", lw=2.2, solid_capstyle="butt")
        axes.annotate(number(rank.mean, 2), (i, 1), (0, 2), textcoords="offset points", ha="center", fontsize=7,
                      bbox={"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.85})  # fmt: skip
    axes.set_ylim(1, last + 0.15)
    axes.set_yticks(range(1, last + 1))
    axes.set_xlim(-0.6, last - 0.4)
    axes.set_ylabel("mean rank (1 is best)")
    axes.grid(axis="y", color="#e6e6e6", lw=0.5)
    axes.set_axisbelow(True)
    labels = [rankings.key.labels[rank.method] for rank in part.ranks] if named else []
    axes.set_xticks(range(len(labels)), labels, fontsize=8)
    axes.tick_params(axis="x", length=0)
    of = "all" if part.n_examples is None else f"{part.n_examples} examples:"
    axes.set_title(f"{of} {_many(part.items, 'item')}", fontsize=8, loc="left")


def _figure_caption(rankings: Rankings) -> str:
    below = " (above), and by number of target examples (below)" if len(rankings.key.counts) > 1 else ""
    figure = "Fig. 11" if rankings.key.design["name"] == "parts" else "Fig. 8"
    return (
        f"Mean rank over all items{below}, given by {_who(rankings)}, as in {figure} of the paper. A "
        "shorter bar is a better rank. What single people and items differ by is seen in the dots and the thin line."
    )


def _ranks_table(rankings: Rankings, part: Part) -> Table:
    rows = tuple(
        (
            rankings.key.labels[r.method],
            number(r.mean, 2),
            bounds(r.low, r.high, 2),
            number(r.spread, 2),
            f"{100 * r.first:.0f} %",
            number(r.by_error, 2),
        )
        for r in part.ranks
    )
    what = "All items" if part.n_examples is None else f"{part.n_examples} examples"
    caption = f"{what}: {part.participants} participants, {part.items} items, {part.rankings} rankings."
    if np.isfinite(part.friedman):
        caption += f" Friedman test that all are ranked alike: p {p_value(part.friedman)}, "
        caption += f"Kendall's W {number(part.agreement, 2)}."
    if part.n_examples is None:
        caption += _COLUMNS
    return Table(("method", "mean rank", "95 % interval", "deviation", "first", "by error"), rows, caption)


def _tests_table(rankings: Rankings, parts: Sequence[Part]) -> Table:
    reference = rankings.key.labels[rankings.key.reference]
    rows = tuple(
        (
            f"{rankings.key.labels[t.method]}, {'all items' if part.n_examples is None else f'{part.n_examples} ex.'}",
            number(t.difference, 2),
            number(t.effect, 2),
            f"{100 * t.wins:.0f} %",
            p_value(t.p),
            p_value(t.p_holm),
            p_value(t.p_items),
            p_value(t.p_items_holm),
            p_value(t.p_pooled),
        )
        for part in parts
        for t in part.tests
    )
    caption = (
        f"Against {reference}, two-sided Wilcoxon signed-rank tests. Difference of the mean ranks, rank-biserial "
        "effect over participants and share of participants who agree: positive and above 50 % where they prefer "
        f"{reference}. p: one value per participant, Holm over the methods, and apart over methods and example "
        "counts. p items: one value per item. p pooled: every single ranking as if it were independent, for contrast; "
        f"nothing is claimed from it. With fewer than {MIN_CLUSTERS} participants or items a test cannot reach 5 %: "
        "not testable."
    )
    heads = ("against the reference", "diff.", "effect", "agree", "p", "p Holm", "p items", "p items Holm", "p pooled")
    return Table(heads, rows, caption)


def _files_table(rankings: Rankings) -> Table:
    key = rankings.key
    rows = [(f"{file.name}", file.sha256) for file in rankings.files]
    rows += [("results shown", key.results), ("code of the study", key.code), ("data of the study", key.data)]
    return Table(
        ("read from", "SHA-256"), tuple(rows), f"Where this comes from. Conditions: {_conditions(key.conditions)}."
    )


def _findings(rankings: Rankings, part: Part) -> list[str]:
    key = rankings.key
    if part.participants < MIN_CLUSTERS:
        return [f"With {part.participants} participants nothing is testable; at least {MIN_CLUSTERS} are needed."]
    reference = key.labels[key.reference]
    ahead = [key.labels[t.method] for t in part.tests if supported(t) and t.difference > 0]
    behind = [key.labels[t.method] for t in part.tests if supported(t) and t.difference < 0]
    open_ = [key.labels[t.method] for t in part.tests if not supported(t)]
    said = []
    if ahead:
        said.append(f"{reference} is ranked ahead of {', '.join(ahead)}.")
    if behind:
        said.append(f"{reference} is ranked behind {', '.join(behind)}.")
    if open_:
        said.append(f"No difference to {', '.join(open_)} is supported by both the test on people and that on items.")
    return said


def _left_out(rankings: Rankings) -> list[str]:
    said = []
    if rankings.tied:
        said.append(f"{_many(rankings.tied, 'ranking')} with ties share the mean of the ranks.")
    if rankings.dropped:
        said.append(f"{_many(rankings.dropped, 'incomplete ranking')} of an item left out.")
    if rankings.absent:
        said.append(f"{_many(rankings.absent, 'participant')} without a complete item left out.")
    return said


def _who(rankings: Rankings) -> str:
    return _many(len(rankings.participants), RATERS[rankings.raters].removesuffix("s"))


def _many(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _counts(rankings: Rankings) -> str:
    return " / ".join(map(str, rankings.key.counts))


def _conditions(conditions: Mapping[str, object]) -> str:
    return ", ".join(f"{name} {value}" for name, value in conditions.items())
