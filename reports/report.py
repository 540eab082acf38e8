"""The report: results folders in, one PDF out. No method runs; the same folders give the same bytes."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
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
from reports.claims import Judged, Status, compared, family, judge, read_claims
from reports.colors import ERROR_COLORMAP
from reports.common import common_times, merged_facts, merged_methods, shared_sentences
from reports.findings import PER_COMPARISON, conditions, favours, findings
from reports.folders import Gathered, Sheet, gather
from reports.glossary import merged_glossary
from reports.heads import HeadPages, error_limit, render_heads
from reports.limits import limits
from reports.load import StudyResults
from reports.method_pages import patch_figure
from reports.ordering import Ordering, overview
from reports.ordering_plot import ordering_plot
from reports.page import write_page
from reports.sheet import pictures
from reports.statistics import REPLICATES, benjamini_hochberg
from reports.structure import structure_figure
from reports.summary import paired_tests, region_tests
from retarget.check import InvalidInput
from retarget.io.files import write_whole

_TEMPLATES = tuple(Path(__file__).with_name(name) for name in ("template.typ", "blocks.typ"))
_NEVER = "1970-01-01T00:00:00+00:00"
_SIGNIFICANT = 0.05


def build_report(
    folders: Sequence[Path], output: Path | None = None, progress: Callable[[str], None] = lambda line: None
) -> Path:
    """Write one PDF about results folders of one or several kinds, and pages beside it; returns the PDF's path.

    The page (`reports.page`) of the only comparison has the PDF's name; of several, that and the study's name.
    Without an output it is report.pdf in the folder itself, or in the folder that holds all of them. The file is
    moved into place when it is whole. Raises InvalidInput for folders that cannot be read, or an output that cannot
    be written.
    """
    gathered = gather(folders)
    path = Path(output) if output is not None else _default_output(gathered.folders)
    if path.suffix == ".html":
        raise InvalidInput(f"output: expected the path of the PDF, got {path}; the page is written beside it.")
    with tempfile.TemporaryDirectory(prefix="report-") as name:
        work = Path(name)
        content = describe(gathered, work, progress)
        progress("typesetting")
        pdf = cast(bytes, typeset(content, work))
        write_whole(path, lambda temporary: temporary.write_bytes(pdf))
        progress("page")
        claims = content["claims"] if len(gathered.groups) == 1 and not gathered.tables else None
        for chapter, group in zip(content["chapters"], gathered.groups, strict=True):
            own = f"{path.stem}-{chapter['name']}" if len(gathered.groups) > 1 else path.stem
            write_page(path.with_name(f"{own}.html"), alone(chapter, group, claims), group, work)
    return path


def alone(
    chapter: dict[str, Any], group: tuple[StudyResults, ...], claims: dict[str, Any] | None = None
) -> dict[str, Any]:
    """A chapter with the claims, decided already or not, and limits of its studies alone: what a page prints."""
    own = Gathered(tuple(study.folder for study in group), (group,), ())
    return chapter | {"claims": claims or _claims(own), "limits": list(limits(own))}


def describe(gathered: Gathered, work: Path, progress: Callable[[str], None]) -> dict[str, Any]:
    """Everything the template prints, as plain data; pictures are written into the folder `work`."""
    studies = [study for group in gathered.groups for study in group]
    chapters = [_chapter(group, work, i, progress) for i, group in enumerate(gathered.groups)]
    progress("published claims")
    titles = [chapter["title"] for chapter in chapters] + [sheet.title for sheet in gathered.sheets]
    structure_figure(work / "structure.svg")
    named = _named(gathered)
    return {
        "title": titles[0] if len(titles) == 1 else "Retargeting methods, evaluated",
        "description": _description(gathered) if len(titles) == 1 else f"{len(titles)} studies: {'; '.join(titles)}.",
        "finished": max((str(s.facts["provenance"]["finished"]) for s in studies), default=_NEVER),
        "chapters": chapters,
        "sheets": [_sheet(sheet, work, i) for i, sheet in enumerate(gathered.sheets)],
        "claims": _claims(gathered),
        "patches": next((p for i, s in enumerate(studies) if (p := patch_figure(s, work, f"patches{i}"))), None),
        "limits": list(limits(gathered, truths=False)),
        "methods": merged_methods(named),
        "protocol": merged_facts([(name, _protocol(study)) for name, study in named]),
        "facts": merged_facts([(name, _facts(study)) for name, study in named]),
        "measured": _measured(studies),
        "glossary": merged_glossary(studies),
        "replicates": REPLICATES,
        "colors": [to_hex(ERROR_COLORMAP(x)) for x in np.linspace(0, 1, 11)],
    }


def _named(gathered: Gathered) -> list[tuple[str, StudyResults]]:
    """Every comparison with a short name of its own."""
    several = len(gathered.groups) > 1
    named = []
    for group in gathered.groups:
        names = Ordering(group).conditions if len(group) > 1 else ("",)
        for name, study in zip(names, group, strict=True):
            said = [str(study.facts["study"])] * several + [name] * bool(name)
            named.append((", ".join(said), study))
    return named


def _measured(studies: Sequence[StudyResults]) -> list[str]:
    """The primary metrics and their units; the template has the formula of the usual one."""
    return sorted({f"{study.facts['primary_metric']} in {study.unit}" for study in studies})


def _protocol(study: StudyResults) -> list[tuple[str, str]]:
    facts = study.facts
    tests = study.metrics.groupby(["source", "target", "draw"])["expression"].nunique().max()
    return [
        ("identities", f"{len(facts['identities'])} ({', '.join(facts['identities'])})"),
        ("draws for each pair", str(facts["draws"])),
        ("expressions held out for the test", str(int(tests))),
        ("expressions in all", str(facts["expressions"])),
        ("examples", ", ".join(map(str, facts["n_examples"]))),
        ("source's counterparts of the examples", str(study.cells["correspondence"].iloc[0])),
        ("primary measure", f"{facts['primary_metric']} on region {facts['primary_region']}"),
    ]


def _description(gathered: Gathered) -> str:
    said = gathered.groups[0][0].facts["description"] if gathered.groups else gathered.sheets[0].description
    return " ".join(str(said).split())


def _chapter(group: Sequence[StudyResults], work: Path, number: int, progress: Callable[[str], None]) -> dict[str, Any]:
    """The studies of one name: one, or the conditions of one another."""
    facts = group[0].facts
    seed = int(facts["provenance"]["seed"])
    box, effect = f"box{number}.svg", f"effect{number}.svg"
    names = Ordering(group).conditions if len(group) > 1 else ("",)
    progress("plots")
    figures.box_plot(group, names, work / box)
    several_counts = len({count for study in group for count in study.facts["n_examples"]}) > 1
    if len(group) > 1 and several_counts:
        figures.condition_effect(group, names, work / effect)
    limit = error_limit(group)
    studies = [_study(study, work, f"study{number}-{i}", limit, progress) for i, study in enumerate(group)]
    general = [PER_COMPARISON]  # said of the claims of the others, a condition without claims needs not say it
    said = [study["findings"] + general * results.sanity for study, results in zip(studies, group, strict=True)]
    shared = shared_sentences(said)
    times = common_times(group)
    return {
        "name": str(facts["study"]),
        "title": facts["title"],
        "description": " ".join(str(facts["description"]).split()),
        "box": box,
        "effect": effect if len(group) > 1 and several_counts else None,
        "correspondences": tables.correspondence_rows(group, seed),
        "shared": shared,
        "times": times,
        "memory": tables.memory(group),
        "glossary": merged_glossary(group),
        "studies": [
            study | {"name": name, "own": [said for said in study["findings"] if said not in shared]}
            for name, study in zip(names, studies, strict=True)
        ],
        "overview": _overview(group, work, f"ordering{number}.svg"),
    }


def _sheet(sheet: Sheet, work: Path, number: int) -> dict[str, Any]:
    """A sheet as the template prints it; its pictures are copied into a folder of `work`."""
    folder = f"sheet{number}/"
    blocks = [block if isinstance(block, Mapping) else asdict(block) for block in sheet.blocks]
    if sheet.folder is not None:
        (work / folder).mkdir()
        for name in pictures(blocks):
            shutil.copy(sheet.folder / name, work / folder / name)
    return {
        "study": sheet.study, "title": sheet.title, "description": sheet.description, "blocks": blocks,
        "folder": folder,
    }  # fmt: skip


def _claims(gathered: Gathered) -> dict[str, Any]:
    """Published claims with what each study says of them; those without any value apart."""
    named = {name or str(study.facts["study"]): study for name, study in _named(gathered) if not study.sanity}
    known = read_claims()
    judged = judge(known, named, gathered.tables)
    return {
        "several": len(named) > 1,
        "studies": list(dict.fromkeys(v.study for j in judged for v in j.verdicts if v.study)),
        "family": family(known),
        "reasons": _reasons(judged),
        "rows": list(_claim_rows(judged)),
        "counts": {status.value: sum(j.status == status for j in judged) for status in Status},
        "shown": [_claim(j) for j in judged if any(v.study for v in j.verdicts)],
        "untested": [_claim(j) for j in judged if not any(v.study for v in j.verdicts)],
    }


def _reasons(judged: Sequence[Judged]) -> list[str]:
    """Why claims could not be tested, each reason once."""
    sentences = (v.sentence for j in judged for v in j.verdicts if v.status == Status.NOT_TESTABLE)
    return list(dict.fromkeys(sentences))


def _claim_rows(judged: Sequence[Judged]) -> Iterator[dict[str, Any]]:
    """A row for each claim; `entries` are its numbers of examples, those of which the same is said together."""
    reasons = _reasons(judged)
    for (section, says), same in itertools.groupby(judged, key=lambda j: (j.claim.section, j.claim.says)):
        entries: list[dict[str, Any]] = []
        group = list(same)
        for j in group:
            notes = sorted({reasons.index(v.sentence) for v in j.verdicts if v.status == Status.NOT_TESTABLE})
            values = {v.study: {"value": v.value, "brief": v.brief} for v in j.verdicts if v.value}
            entry = {"status": j.status.value, "notes": notes, "values": values}
            if not values and entries and {k: entries[-1][k] for k in entry} == entry:
                entries[-1]["counts"] += f", {_examples(j)}"
            else:
                entries.append({"counts": _examples(j)} | entry)
        yield {
            "section": section,
            "says": says,
            "published": group[0].claim.published,
            "compared": compared(group[0].claim),
            "entries": entries,
        }


def _examples(judged: Judged) -> str:
    return ", ".join(map(str, judged.claim.counts))


def _claim(judged: Judged) -> dict[str, Any]:
    claim = judged.claim
    return {
        "section": claim.section,
        "says": claim.says,
        "counts": claim.counts,
        "published": claim.published,
        "status": judged.status.value,
        "compared": compared(claim),
        "verdicts": [asdict(verdict) for verdict in judged.verdicts],
    }


def typeset(
    content: dict[str, Any], work: Path, format: Literal["pdf", "png"] = "pdf", ppi: float = 144.0
) -> bytes | list[bytes]:
    """Compile the template in the folder `work`, which holds the pictures; bytes, for "png" one per page."""
    (work / "content.json").write_text(json.dumps(content, default=lambda value: value.item()), encoding="utf-8")
    for template in _TEMPLATES:
        shutil.copy(template, work / template.name)
    compiled = typst.compile(
        str(work / _TEMPLATES[0].name),
        root=str(work),
        format=format,
        ppi=ppi,
        font_paths=[str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")],
        ignore_system_fonts=True,
        timestamp=int(_time(content["finished"]).timestamp()),
    )
    return cast(bytes | list[bytes], compiled)


def _study(
    study: StudyResults, work: Path, prefix: str, limit: float, progress: Callable[[str], None]
) -> dict[str, Any]:
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
    figures.example_effect(study, work / f"{prefix}-examples.svg")
    if len(everyone):
        figures.ratio_plot(study, everyone, work / f"{prefix}-ratio.svg")
    progress("rendering heads")
    heads = render_heads(study, work, prefix, limit=limit)
    different = {} if tables.no_claim(study) else _different_regions(study)
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
        "examples": f"{prefix}-examples.svg" if len(facts["n_examples"]) > 1 else None,
        "ratio": f"{prefix}-ratio.svg" if len(everyone) else None,
        "regions": regions,
        "heads": _heads(heads),
        "tests": tables.test_rows(study, primary.assign(adjusted=primary["p_holm"])),
        "no_claim": tables.no_claim(study),
        "family": {"run": int((primary["n_pairs"] > 0).sum()), "declared": len(family) * len(facts["n_examples"])},
        "secondary": tables.test_rows(study, secondary),
        "times": tables.time_rows(study),
        "everything": tables.every_measure(study),
        "statuses": tables.status_rows(study),
        "solves": tables.solve_rows(study),
        "cells": len(study.cells),
        "settings": tables.setting_rows(study),
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


def _overview(studies: Sequence[StudyResults], work: Path, plot: str) -> dict[str, Any] | None:
    """The order of methods under each condition, side by side, where there are several."""
    if len(studies) < 2:
        return None
    ordering = Ordering(studies)
    ordering_plot(ordering, work / plot)
    return overview(ordering) | {"plot": plot}


def _default_output(folders: Sequence[Path]) -> Path:
    parents = list(dict.fromkeys(folder.resolve() for folder in folders))
    return Path(os.path.commonpath(parents)) / "report.pdf"


def _time(text: str) -> datetime:
    moment = datetime.fromisoformat(text)
    return moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)
