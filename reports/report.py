"""The report: results folders in, one PDF out. No method runs; the same folders give the same bytes."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, cast

import matplotlib
import numpy as np
import pandas as pd
import typst
from matplotlib.colors import to_hex

from reports import figures, tables
from reports.colors import ERROR_COLORMAP
from reports.findings import conditions, favours, findings
from reports.heads import HeadPages, render_heads
from reports.load import StudyResults, load
from reports.ordering import Ordering, overview
from reports.ordering_plot import ordering_plot
from reports.page import write_page
from reports.statistics import REPLICATES, benjamini_hochberg
from reports.summary import paired_tests, region_tests
from retarget.check import InvalidInput
from retarget.io.files import write_whole

_TEMPLATE = Path(__file__).with_name("template.typ")
_SIGNIFICANT = 0.05


def build_report(
    folders: Sequence[Path], output: Path | None = None, progress: Callable[[str], None] = lambda line: None
) -> Path:
    """Write one PDF about one or several results folders, and a page beside it (`reports.page`); returns its path.

    Without an output it is report.pdf in the folder itself, or in the folder that holds all of them. The file is
    moved into place when it is whole. Raises InvalidInput for folders that cannot be read, or an output that cannot
    be written.
    """
    studies = load(folders)
    path = Path(output) if output is not None else _default_output(studies)
    if path.suffix == ".html":
        raise InvalidInput(f"output: expected the path of the PDF, got {path}; the page is written beside it.")
    with tempfile.TemporaryDirectory(prefix="report-") as name:
        work = Path(name)
        content = describe(studies, work, progress)
        progress("typesetting")
        pdf = cast(bytes, typeset(content, work))
    write_whole(path, lambda temporary: temporary.write_bytes(pdf))
    progress("page")
    write_page(path.with_suffix(".html"), content, studies)
    return path


def describe(studies: Sequence[StudyResults], work: Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """Everything the template prints, as plain data; pictures are written into the folder `work`."""
    first = studies[0]
    return {
        "title": first.facts["title"],
        "description": " ".join(str(first.facts["description"]).split()),
        "finished": max(str(s.facts["provenance"]["finished"]) for s in studies),
        "correspondences": tables.correspondence_rows(studies, int(first.facts["provenance"]["seed"])),
        "studies": [_study(study, work, f"study{i}", progress) for i, study in enumerate(studies)],
        "overview": _overview(studies, work),
        "colors": [to_hex(ERROR_COLORMAP(x)) for x in np.linspace(0, 1, 11)],
    }


def typeset(
    content: dict[str, Any], work: Path, format: Literal["pdf", "png"] = "pdf", ppi: float = 144.0
) -> bytes | list[bytes]:
    """Compile the template in the folder `work`, which holds the pictures; bytes, for "png" one per page."""
    (work / "content.json").write_text(json.dumps(content, default=lambda value: value.item()), encoding="utf-8")
    shutil.copy(_TEMPLATE, work / "template.typ")
    compiled = typst.compile(
        str(work / "template.typ"),
        root=str(work),
        format=format,
        ppi=ppi,
        font_paths=[str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")],
        ignore_system_fonts=True,
        timestamp=int(_time(content["finished"]).timestamp()),
    )
    return cast(bytes | list[bytes], compiled)


def _study(study: StudyResults, work: Path, prefix: str, progress: Callable[[str], None]) -> dict[str, Any]:
    facts = study.facts
    metric, region = facts["primary_metric"], facts["primary_region"]
    seed = int(facts["provenance"]["seed"])
    rows = study.metrics[study.metrics["metric"] == metric]
    untested = {facts["reference"], *(m.name for m in study.methods if m.kind == "reference")}
    family = [name for name in facts["primary_family"] if name not in untested]
    others = [name for name in study.tested if name not in family]
    primary = paired_tests(rows[rows["region"] == region], facts["reference"], family, metric, region, seed)
    secondary = paired_tests(rows[rows["region"] == region], facts["reference"], others, metric, region, seed)
    secondary["adjusted"] = benjamini_hochberg(secondary["p"])
    everyone = pd.concat([table for table in (primary, secondary) if len(table)] or [primary], ignore_index=True)
    progress("plots")
    figures.box_plot(study, work / f"{prefix}-box.svg")
    figures.example_effect(study, work / f"{prefix}-examples.svg")
    if len(everyone):
        figures.ratio_plot(study, everyone, work / f"{prefix}-ratio.svg")
    progress("rendering heads")
    heads = render_heads(study, work, prefix)
    different = _different_regions(study)
    regions = []
    for count in facts["n_examples"]:
        names, body = tables.region_rows(study, count, different.get(count, set()))
        regions.append({"count": count, "regions": [name.replace("_", " ") for name in names], "rows": body})
    return {
        "label": study.differs,
        "title": facts["title"],
        "conditions": conditions(study),
        "favours": favours(study),
        "facts": _facts(study),
        "findings": list(findings(study, primary)),
        "counts": facts["n_examples"],
        "reference": study.label(facts["reference"]),
        "metric": metric,
        "unit": study.unit,
        "region": region,
        "pairs": sorted(set(study.primary.loc[study.primary["n_pairs"] > 0, "n_pairs"].astype(int))),
        "summary": tables.summary_rows(study, metric, region),
        "tables": [
            {
                "metric": also,
                "region": where,
                "unit": study.unit_of(also),
                "summary": tables.summary_rows(study, also, where),
            }
            for also, where in study.measured(facts.get("tables", ()))
        ],
        "measures": tables.measure_rows(study, seed),
        "parts": study.label(str(facts.get("parts"))),
        "box": f"{prefix}-box.svg",
        "examples": f"{prefix}-examples.svg" if len(facts["n_examples"]) > 1 else None,
        "ratio": f"{prefix}-ratio.svg" if len(everyone) else None,
        "regions": regions,
        "heads": _heads(heads),
        "tests": tables.test_rows(study, primary.assign(adjusted=primary["p_holm"])),
        "family": {"run": int((primary["n_pairs"] > 0).sum()), "declared": len(family) * len(facts["n_examples"])},
        "secondary": tables.test_rows(study, secondary),
        "times": tables.time_rows(study),
        "statuses": tables.status_rows(study),
        "solves": tables.solve_rows(study),
        "cells": len(study.cells),
        "settings": tables.setting_rows(study),
        "protocol": {
            "identities": len(facts["identities"]),
            "names": ", ".join(facts["identities"]),
            "draws": facts["draws"],
            "expressions": facts["expressions"],
            "vertices": facts["vertices"],
            "replicates": REPLICATES,
            "tests": int(study.metrics.groupby(["source", "target", "draw"])["expression"].nunique().max()),
            "correspondence": str(study.cells["correspondence"].iloc[0]),
        },
    }


def _different_regions(study: StudyResults) -> dict[int, set[tuple[str, str]]]:
    """Per example count (method, region) that differ from the reference after Benjamini-Hochberg over all of them."""
    tests = region_tests(study.metrics, study.facts["reference"], study.tested, study.facts["primary_metric"])
    different: dict[int, set[tuple[str, str]]] = {}
    for test in tests[benjamini_hochberg(tests["p"]) < _SIGNIFICANT].to_dict("records"):
        different.setdefault(int(test["n_examples"]), set()).add((test["method"], test["region"]))
    return different


def _facts(study: StudyResults) -> list[tuple[str, str]]:
    p, data = study.facts["provenance"], study.facts["dataset"]
    packages = ", ".join(f"{name} {version}" for name, version in sorted(p["packages"].items()))
    minutes, seconds = divmod(round(float(p["wall_seconds"])), 60)
    return [
        ("Study", f"{study.facts['study']}, seed {p['seed']}"),
        ("Conditions", conditions(study)),
        ("Identities", f"{len(study.facts['identities'])}: {', '.join(study.facts['identities'])}"),
        ("Size", f"{study.facts['vertices']:,} vertices, {study.facts['faces']:,} triangles, "
                 f"{study.facts['expressions']} expressions, {len(study.cells):,} cells"),
        ("Run", f"{_time(p['finished']):%d %B %Y, %H:%M} UTC, {minutes} min {seconds} s"),
        ("Machine", f"{p['platform']}, {_count(p['cores'], 'core')}, {_count(p['threads'], 'thread')}"),
        ("Software", f"version {p['project_version']}, Python {p['python']}, {packages}"),
        ("Code", str(p["code_hash"])[:16]),
        ("Data", str(data["fingerprint"])[:16]),
    ]  # fmt: skip


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def _heads(heads: HeadPages | None) -> dict[str, Any] | None:
    return None if heads is None else asdict(heads)


def _overview(studies: Sequence[StudyResults], work: Path) -> dict[str, Any] | None:
    """The order of methods under each condition, side by side, where the report covers several."""
    if len(studies) < 2:
        return None
    ordering = Ordering(studies)
    ordering_plot(ordering, work / "ordering.svg")
    return overview(ordering) | {"plot": "ordering.svg"}


def _default_output(studies: Sequence[StudyResults]) -> Path:
    parents = [study.folder.resolve() for study in studies]
    return Path(os.path.commonpath(parents)) / "report.pdf" if len(parents) > 1 else studies[0].folder / "report.pdf"


def _time(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    return moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
