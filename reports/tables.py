"""Results as rows of printed text, ready for the terminal and the report."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import to_hex

from reports.claims import FEWEST
from reports.colors import ERROR_COLORMAP
from reports.findings import ALPHA
from reports.load import StudyResults
from reports.summary import paired_tests
from reports.text import bounds, decimals, entry, number, p_value, rank_biserial, seconds

Row = dict[str, Any]


def summary_rows(study: StudyResults, metric: str, region: str) -> list[Row]:
    """Methods x example counts of one measure: {label, kind, cells: [{value, interval, ratio, p, best}]}.

    All means and bounds have the same decimals.
    """
    primary = study.at(metric, region).set_index(["method", "n_examples"])
    digits = decimals(primary["mean"])
    counts = study.facts["n_examples"]
    best = {count: _smallest(study, primary, count) for count in counts}
    rows: list[Row] = []
    for method in study.methods:
        cells = []
        for count in counts:
            if (method.name, count) not in primary.index:
                cells.append({"value": "not run", "interval": "", "ratio": "", "best": False, "failed": 0})
                continue
            r = primary.loc[(method.name, count)]
            known = math.isfinite(r["mean"])
            cells.append(
                {
                    "value": entry(r["mean"], digits) if known else "no result",
                    "interval": bounds(r["ci_low"], r["ci_high"], digits, entry) if known else "",
                    "ratio": entry(r["ratio"], 2) if math.isfinite(r["ratio"]) else "",
                    "best": method.name == best[count],
                    "failed": int(r["n_failed"]),
                }
            )
        reference = method.name == study.facts["reference"]
        rows.append({"label": method.label, "kind": method.kind, "reference": reference, "cells": cells})
    return rows


def every_measure(study: StudyResults, most: tuple[int, int] = (64, 16)) -> dict[str, Any] | None:
    """Means of all that was measured at the largest number of examples: {count, labels, rows}; None beyond `most`.

    Rows {measure, region, unit, cells} of one measure follow each other and have the same decimals. most: rows and
    columns that fit on a page.
    """
    count = max(study.facts["n_examples"])
    here = study.summary[study.summary["n_examples"] == count]
    means = here.pivot(index=["metric", "region"], columns="method", values="mean")
    measured = list(dict.fromkeys(zip(here["metric"], here["region"], strict=True)))
    names = list(dict.fromkeys(metric for metric, _ in measured))
    order = sorted(measured, key=lambda pair: names.index(pair[0]))
    methods = [m for m in study.methods if m.name in means.columns]
    if len(order) > most[0] or len(methods) > most[1]:
        return None
    rows = []
    for metric, region in order:
        values = means.loc[(metric, region)].reindex([m.name for m in methods])
        digits = decimals(means.loc[metric].to_numpy().ravel(), least=1, significant=3)
        cells = [entry(value, digits) if math.isfinite(value) else "n/a" for value in values]
        rows.append({"measure": metric, "region": region, "unit": study.unit_of(metric), "cells": cells})
    return {"count": count, "labels": [m.label for m in methods], "rows": rows}


def region_rows(study: StudyResults, count: int, different: set[tuple[str, str]]) -> tuple[list[str], list[Row]]:
    """(regions, rows {label, cells: [{text, fill, dark, strong}]}) of the primary metric at one example count.

    `different` holds (method, region) whose difference to the reference survives the correction.
    """
    s = study.summary
    rows = s[(s["metric"] == study.facts["primary_metric"]) & (s["n_examples"] == count)]
    primary = study.facts["primary_region"]
    regions = [primary, *sorted(set(rows["region"]) - {primary})]
    mean = rows.pivot(index="method", columns="region", values="mean")
    shown = [m for m in study.methods if m.name in mean.index]
    scale = [mean.loc[m.name].max() for m in shown if m.name != "neutral"]
    top = float(np.nanmax(scale)) if scale and np.isfinite(scale).any() else 1.0
    return regions, [
        {
            "label": m.label,
            "kind": m.kind,
            "cells": [
                _heat(mean.loc[m.name, region], top, (m.name, region) in different, m.name == "neutral")
                for region in regions
            ],
        }
        for m in shown
    ]


def _heat(value: float, top: float, strong: bool, plain: bool) -> Row:
    if not math.isfinite(value):
        return {"text": "n/a", "fill": "#ffffff", "dark": False, "strong": False}
    share = 0.0 if plain else 0.62 * min(value / top, 1.0)
    fill = "#ffffff" if plain else to_hex(ERROR_COLORMAP(share))
    return {"text": entry(value), "fill": fill, "dark": share > 0.5, "strong": strong}


def no_claim(study: StudyResults) -> str:
    """Why no difference of a study can be claimed, so that none is bold; empty where one can."""
    if study.sanity:
        return "This truth is a check, from which nothing is claimed: nothing is bold."
    few = len(study.facts["identities"]) < FEWEST
    return "With so few people nothing can be claimed, and nothing is bold." if few else ""


def test_rows(study: StudyResults, tests: pd.DataFrame) -> list[Row]:
    """Rows of `summary.paired_tests` as text, ordered by example count and the study's table.

    `strong` says that an adjusted p is below 5 % in a study of enough people to claim anything.
    """
    order = {m.name: i for i, m in enumerate(study.methods)}
    ordered = tests.assign(order=tests["method"].map(order)).sort_values(["n_examples", "order"], kind="stable")
    return [_test_row(study, row) for row in ordered.to_dict("records")]


def _test_row(study: StudyResults, r: Mapping[Any, Any]) -> Row:
    row: Row = {"count": int(r["n_examples"]), "label": study.label(r["method"]), "pairs": int(r["n_pairs"])}
    row["strong"] = bool(r["adjusted"] < ALPHA) and not no_claim(study)
    if not row["pairs"]:
        nothing = dict.fromkeys(("ratio", "interval", "effect", "wins", "p", "p_sources", "p_targets", "p_naive"), "")
        return row | nothing | {"adjusted": "no result"}
    return row | {
        "ratio": entry(r["ratio"], 2),
        "interval": bounds(r["ratio_low"], r["ratio_high"], 2, entry),
        "effect": rank_biserial(r["effect"]),
        "wins": f"{100 * r['win_rate']:.0f} %",
        "p": p_value(r["p"]),
        "adjusted": p_value(r["adjusted"]),
        "p_sources": p_value(r["p_sources"]),
        "p_targets": p_value(r["p_targets"]),
        "p_naive": p_value(r["p_naive"]),
    }


def measure_rows(study: StudyResults, seed: int) -> list[Row]:
    """What each row of `study.measures` was meant to change, against the reference, by measure and example count."""
    rows: list[Row] = []
    reference = study.facts["reference"]
    for method, listed in study.facts.get("measures", {}).items():
        for metric, region in study.measured(listed):
            taken = study.metrics[(study.metrics["metric"] == metric) & (study.metrics["region"] == region)]
            means = study.at(metric, region).set_index(["method", "n_examples"])["mean"]
            unit, digits = study.unit_of(metric), decimals(means)
            tests = paired_tests(taken, reference, [method], metric, region, seed)
            for row in test_rows(study, tests.assign(adjusted=tests["p"])):
                mine, other = (entry(means.get((name, row["count"]), math.nan), digits) for name in (method, reference))
                measure = f"{metric}, {region}" + (f", {unit}" if unit != "1" else "")
                rows.append(row | {"measure": measure, "mean": mine, "reference": other})
    return rows


def correspondence_rows(studies: Sequence[StudyResults], seed: int) -> list[Row]:
    """Every method with other source examples against itself with given ones; empty unless both were studied."""
    by_name = {str(study.cells["correspondence"].iloc[0]): study for study in studies}
    if len(by_name) < 2 or len(by_name) < len(studies) or "given" not in by_name:
        return []
    first = by_name["given"]
    metric, region = first.facts["primary_metric"], first.facts["primary_region"]
    taken = pd.concat([study.metrics for study in studies])
    taken = taken[(taken["metric"] == metric) & (taken["region"] == region)]
    others = [name for name in by_name if name != "given"]
    rows: list[Row] = []
    for method in first.tested:
        mine = taken[taken["method"] == method]
        named = mine.assign(method=mine["correspondence"], correspondence="")
        tests = paired_tests(named, "given", others, metric, region, seed)
        rows += [row | {"method": first.label(method)} for row in test_rows(first, tests.assign(adjusted=tests["p"]))]
    return rows


def solve_rows(study: StudyResults) -> list[Row]:
    """Methods whose solves did not all converge: {label, count, solves, late, failed}."""
    if "solves" not in study.cells:
        return []
    counts = study.cells.groupby(["method", "n_examples"], sort=False)[
        ["solves", "solves_not_converged", "solves_failed"]
    ].sum()
    return [
        {"label": study.label(m.name), "count": count, "solves": int(total), "late": int(late), "failed": int(failed)}
        for m in study.methods
        for count in study.facts["n_examples"]
        if (m.name, count) in counts.index
        for total, late, failed in [counts.loc[(m.name, count)]]
        if late or failed
    ]


def time_rows(study: StudyResults) -> list[Row]:
    """Median and quartiles of set-up and per-expression times: {label, prepare, fit: [per count], frame}."""
    rows: list[Row] = []
    for m in study.methods:
        if m.kind == "reference":
            continue
        c = study.cells[study.cells["method"] == m.name]
        per_pair = c.drop_duplicates(["source", "target"])["prepare_seconds"]
        rows.append(
            {
                "label": m.label,
                "prepare": _quartiles(per_pair),
                "fit": [
                    _quartiles(c.loc[c["n_examples"] == count, "fit_seconds"]) for count in study.facts["n_examples"]
                ],
                "frame": _quartiles(c["seconds_per_expression"]),
            }
        )
    return rows


def _quartiles(values: pd.Series[float]) -> Row:
    known = values.dropna()
    if known.empty:
        return {"median": "n/a", "range": ""}
    low, middle, high = np.quantile(known.to_numpy(dtype=np.float64), [0.25, 0.5, 0.75])
    return {"median": seconds(middle), "range": seconds(middle, low, high)}


def memory(studies: Sequence[StudyResults]) -> str:
    """MB of the largest process that ran cells of these studies; it ran other methods before."""
    highest = [float(study.cells["peak_memory_mb"].max()) for study in studies]
    return number(max(highest), 0)


def status_rows(study: StudyResults) -> list[Row]:
    """Every method x example count x status other than `ok`: {label, count, status, cells, of, reason}."""
    unfinished = study.cells[study.cells["status"] != "ok"]
    order = {m.name: i for i, m in enumerate(study.methods)}
    groups: Any = unfinished.groupby(["method", "n_examples", "status"], sort=False)
    rows = [
        {
            "order": order.get(method, len(order)),
            "label": study.label(method),
            "count": int(count),
            "status": str(status).replace("_", " "),
            "cells": len(group),
            "of": int(((study.cells["method"] == method) & (study.cells["n_examples"] == count)).sum()),
            "reason": _reasons(group["reason"]),
        }
        for (method, count, status), group in groups
    ]
    return sorted(rows, key=lambda row: (row["order"], row["count"], row["status"]))


def _reasons(reasons: pd.Series[str]) -> str:
    counts = reasons.fillna("").replace("", "no reason given").value_counts()
    shown = [f"{reason} ({n} cells)" if len(counts) > 1 else str(reason) for reason, n in counts.head(3).items()]
    return "; ".join(shown) + (f"; {len(counts) - 3} other reasons" if len(counts) > 3 else "")


def setting_rows(study: StudyResults) -> list[Row]:
    """{label, kind, description, settings} of every row of the study's table."""
    told: dict[str, dict[str, Any]] = {}  # by label: those written out
    rows = []
    for m in study.methods:
        own = dict(_settings(m.settings)) if m.kind != "reference" else {}
        settings = _beside(own, told)
        if len(settings) == len(own):
            told[m.label] = own
        description = " ".join(m.description.split())
        rows.append({"label": m.label, "kind": m.kind, "description": description, "settings": settings})
    return rows


def _beside(own: Mapping[str, Any], told: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Settings as text; where most are those of a row above, what differs from it."""
    for label, above in told.items():
        differing = [f"{key} = {value}" for key, value in own.items() if above.get(key) != value]
        if own.keys() == above.keys() and 2 * len(differing) < len(own) - 2:
            return [f"as {label}, but {differing[0]}", *differing[1:]] if differing else [f"as {label}"]
    return [f"{key} = {value}" for key, value in own.items()]


def _settings(settings: Any) -> Iterator[tuple[str, Any]]:
    for key, value in settings.items():
        if key == "_target_":
            continue
        if isinstance(value, dict):
            yield from ((f"{key}.{inner}", v) for inner, v in _settings(value))
        else:
            yield key, "none" if value is None else value


def _smallest(study: StudyResults, primary: pd.DataFrame, count: int) -> str | None:
    means: Mapping[Any, float] = primary["mean"].dropna().to_dict()
    known = [name for name in study.tested if (name, count) in means]
    if any(means[(name, count)] < 0 for name in known):
        return None  # a signed measure: the smallest is not the best
    return min(known, key=lambda name: means[(name, count)], default=None)
