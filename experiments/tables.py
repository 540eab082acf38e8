"""What a finished study writes beside its records: metrics, cells, summary, and its own description."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import pandas as pd
import pyarrow as pa

from experiments.catalogue import sentence
from experiments.glossary import glossary
from experiments.plan import Plan
from experiments.record import SCHEMA, read_header, read_record
from experiments.references import REFERENCES
from experiments.study import Row
from experiments.version import environment
from reports.summary import summarise
from retarget.check import InvalidInput
from retarget.io.files import write_whole
from retarget.types import Status

SECONDS = ("prepare_seconds", "correspondence_seconds", "fit_seconds", "seconds_per_expression")


def collect(planned: Plan) -> tuple[pd.DataFrame, pd.DataFrame]:
    """(metrics, cells): every planned cell read back, in the plan's order."""
    rows, cells = [], []
    for cell in planned.cells:
        record = read_record(planned.folder / cell.id)
        if record is None:
            raise InvalidInput(f"{planned.folder / cell.id}: its record vanished while the study ran; start it again.")
        rows.append(record.rows)
        header = record.header
        cells.append(
            {
                "cell": cell.id,
                "method": cell.row.name,
                "source": cell.source,
                "target": cell.target,
                "n_examples": cell.n_examples,
                "draw": cell.draw,
                **vars(planned.dataset.conditions),
                "correspondence": cell.correspondence,
                **{key: header[key] for key in ("status", "reason", "prediction")},
                **{key: _number(header[key]) for key in SECONDS},
                "peak_memory_mb": header["peak_memory_mb"],
                **_solves(header["solves"]),
            }
        )
    return pa.concat_tables(rows).to_pandas(), pd.DataFrame(cells)


def write_tables(
    planned: Plan, tables: tuple[pd.DataFrame, pd.DataFrame], config: Mapping[str, Any], started: datetime
) -> pd.DataFrame:
    """metrics.parquet, cells.parquet, summary.csv and study.json beside the records; returns the summary."""
    metrics, cells = tables
    study, folder = planned.study, planned.folder
    summary = summarise(
        metrics,
        study.reference,
        [name for name in study.primary_family if name not in study.references],
        study.primary_metric,
        study.primary_region,
        study.seed,
    )
    write_whole(folder / "metrics.parquet", lambda temporary: metrics.to_parquet(temporary, index=False))
    write_whole(folder / "cells.parquet", lambda temporary: cells.to_parquet(temporary, index=False))
    write_whole(folder / "summary.csv", lambda temporary: summary.to_csv(temporary, index=False))
    described = _describe(planned, config, started) | {"glossary": _glossary(planned, metrics, cells)}
    description = json.dumps(described, indent=1)
    write_whole(folder / "study.json", lambda temporary: temporary.write_text(description))
    return summary


def _describe(planned: Plan, config: Mapping[str, Any], started: datetime) -> dict[str, Any]:
    study, dataset = planned.study, planned.dataset
    finished = datetime.now(UTC)
    return {
        "schema": SCHEMA,
        "study": study.name,
        "title": study.title,
        "description": study.description,
        "config": config,
        "reference": study.reference,
        "primary_family": list(study.primary_family),
        "primary_metric": study.primary_metric,
        "primary_region": study.primary_region,
        "tables": [list(measure) for measure in study.tables],
        "measures": {name: [list(measure) for measure in measures] for name, measures in study.measures.items()},
        "parts": study.figures.parts,
        "methods": [
            {
                "name": row.name,
                "label": row.name,
                "description": _description(row),
                "kind": _kind(row),
                "settings": dict(row.settings),
            }
            for row in planned.rows
        ],
        "metrics_left_out": dict(planned.left_out),
        "n_examples": list(study.n_examples),
        "draws": study.draws,
        "identities": list(dataset.identities),
        "expressions": len(dataset.expressions),
        "vertices": len(dataset.neutral(dataset.identities[0])),
        "faces": len(dataset.faces),
        "dataset": {
            "name": dataset.conditions.dataset,
            "truth": dataset.conditions.truth,
            "weights": dataset.conditions.weights,
            "noise_mm": dataset.conditions.noise_mm,
            "favours": dataset.favours,
            "fingerprint": dataset.fingerprint,
        },
        "provenance": environment()
        | {
            "threads": config["backend"]["threads"],
            "started": started.isoformat(timespec="seconds"),
            "finished": finished.isoformat(timespec="seconds"),
            "wall_seconds": round((finished - started).total_seconds(), 1),
            "seed": study.seed,
        },
    }


def _glossary(planned: Plan, metrics: pd.DataFrame, cells: pd.DataFrame) -> dict[str, Any]:
    """What the tables name, in words."""
    headers = (read_header(planned.folder / cell.id) for cell in planned.cells)
    known = (header["directions"] for header in headers if header)
    directions: Mapping[str, str] = next(filter(None, known), {})
    named = [f"{column} {name}" for column in ("weights", "correspondence") for name in cells[column].unique()]
    return glossary(metrics["metric"].unique(), directions, named)


def _kind(row: Row) -> str:
    if row.method is None:
        return "reference"
    return "control" if row.method.control else "method"


def _description(row: Row) -> str:
    if row.method is None:
        return REFERENCES[row.name].__doc__ or ""
    return row.description or sentence("method", row.name)


def _solves(solves: Sequence[Mapping[str, Any]]) -> dict[str, int]:
    """How many solves of a cell there were, and how they ended."""
    ended = Counter(solve["status"] for solve in solves)
    return {
        "solves": len(solves),
        "solves_not_converged": ended[Status.MAX_ITERATIONS],
        "solves_failed": ended[Status.FAILED],
    }


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
