"""Run a study: plan it, compute the cells that are missing, write its tables and its report."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from reports.report import build_report
from reports.summary import summarise
from reports.terminal import print_summary
from rich.console import Console

from experiments.backend import Backend
from experiments.catalogue import sentence
from experiments.evaluate import Cell, evaluate_pair
from experiments.metrics.metric import Metric
from experiments.plan import Plan, plan
from experiments.progress import duration, progress
from experiments.record import SCHEMA, read_record, write_whole
from experiments.references import REFERENCES
from experiments.study import Row, Study
from experiments.version import environment
from retarget.check import InvalidInput
from retarget.types import Retargeter


def run(config: DictConfig, folder: Path, console: Console) -> None:
    """The main job. Raises InvalidInput with what to do if the configuration or the data cannot be used."""
    started = datetime.now(UTC)
    check_folder(folder)
    study = Study.from_config(_plain(config.study))
    methods = [Row(name, _plain(node), _method(name, node)) for name, node in config.method.items()]
    metrics: dict[str, tuple[Metric, Mapping[str, Any]]] = {
        str(name): (instantiate(node), _plain(node)) for name, node in config.metric.items()
    }
    dataset = instantiate(config.dataset).load(lambda line: console.print(f"  {line}"))
    planned = plan(study, dataset, methods, metrics, folder)
    compute(planned, instantiate(config.backend), console)
    tables = collect(planned)
    summary = write_tables(planned, tables, config, started)
    print_summary(summary, console, metric=study.primary_metric, region=study.primary_region)
    for name in ("metrics.parquet", "summary.csv"):
        console.print(f"{folder / name}", soft_wrap=True)
    if config.report:
        report = build_report([folder], None, lambda line: console.print(f"  {line}"))
        console.print(f"{report}", soft_wrap=True)


def check_folder(folder: Path) -> None:
    """Raises InvalidInput unless files can be written there."""
    write_whole(folder / ".writable", lambda temporary: temporary.write_text(""))
    (folder / ".writable").unlink(missing_ok=True)


def compute(planned: Plan, backend: Backend, console: Console) -> None:
    """Compute the cells that have no current record."""
    missing = [cell for cell in planned.cells if planned.finished(cell) is None]
    pairs = len({(cell.source, cell.target) for cell in planned.cells})
    reused = len(planned.cells) - len(missing)
    console.print(
        f"{planned.study.title}: {len(planned.rows)} rows x {pairs} pairs x "
        f"{list(planned.study.n_examples)} examples x {planned.study.draws} draws = {len(planned.cells)} cells"
        + (f", {reused} of them finished earlier" if reused else "")
    )
    console.print(f"estimated time: {_estimate(planned, missing)}")
    with progress(console, "cells", len(missing)) as advance:
        for done in backend.run(evaluate_pair, planned.tasks(missing)):
            advance(done)


def _estimate(planned: Plan, missing: list[Cell]) -> str:
    """From the cells of this study that have been computed on this machine before."""
    seconds: dict[str, list[float]] = {}
    for cell in planned.cells:
        header = planned.finished(cell)
        if header is not None and header["fit_seconds"] is not None:
            per_frame = header["seconds_per_expression"] * planned.study.test_expressions
            seconds.setdefault(cell.row.name, []).append(header["fit_seconds"] + per_frame)
    if not missing:
        return "nothing left to compute"
    if not seconds:
        return "no earlier cells to judge by; the remaining time is shown as soon as the first pair is done"
    typical = {name: sum(values) / len(values) for name, values in seconds.items()}
    total = sum(typical.get(cell.row.name, 0.0) for cell in missing)
    return f"about {duration(total)} of computing for the {len(missing)} cells left"


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
                "correspondence": planned.study.correspondence,
                **{key: header[key] for key in ("status", "reason", "prediction")},
                **{key: _number(header[key]) for key in ("prepare_seconds", "fit_seconds", "seconds_per_expression")},
                "peak_memory_mb": header["peak_memory_mb"],
            }
        )
    return pd.concat(rows, ignore_index=True), pd.DataFrame(cells)


def write_tables(
    planned: Plan, tables: tuple[pd.DataFrame, pd.DataFrame], config: DictConfig, started: datetime
) -> pd.DataFrame:
    """metrics.parquet, cells.parquet, summary.csv and study.json beside the records; returns the summary."""
    metrics, cells = tables
    study, folder = planned.study, planned.folder
    summary = summarise(
        metrics,
        study.reference,
        study.primary_family,
        study.primary_metric,
        study.primary_region,
        study.seed,
    )
    write_whole(folder / "metrics.parquet", lambda temporary: metrics.to_parquet(temporary, index=False))
    write_whole(folder / "cells.parquet", lambda temporary: cells.to_parquet(temporary, index=False))
    write_whole(folder / "summary.csv", lambda temporary: summary.to_csv(temporary, index=False))
    description = json.dumps(_describe(planned, config, started), indent=1)
    write_whole(folder / "study.json", lambda temporary: temporary.write_text(description))
    return summary


def _describe(planned: Plan, config: DictConfig, started: datetime) -> dict[str, Any]:
    study, dataset = planned.study, planned.dataset
    finished = datetime.now(UTC)
    return {
        "schema": SCHEMA,
        "study": study.name,
        "title": study.title,
        "description": study.description,
        "config": _plain(config),
        "reference": study.reference,
        "primary_family": list(study.primary_family),
        "primary_metric": study.primary_metric,
        "primary_region": study.primary_region,
        "methods": [
            {
                "name": row.name,
                "label": row.name.replace("_", " "),
                "description": _description(row),
                "kind": "method" if row.method else "reference",
                "settings": dict(row.settings),
            }
            for row in planned.rows
        ],
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
            "threads": config.backend.threads,
            "started": started.isoformat(timespec="seconds"),
            "finished": finished.isoformat(timespec="seconds"),
            "wall_seconds": round((finished - started).total_seconds(), 1),
            "seed": study.seed,
        },
    }


def _description(row: Row) -> str:
    return sentence("method", row.name) if row.method else (REFERENCES[row.name].__doc__ or "")


def _method(name: Any, node: DictConfig) -> Retargeter:
    method = instantiate(node)
    if not isinstance(method, Retargeter):
        raise InvalidInput(
            f"method {name}: {node.get('_target_')} makes a {type(method).__name__}, expected a Retargeter."
        )
    return method


def _plain(node: DictConfig) -> dict[str, Any]:
    return dict(OmegaConf.to_container(node, resolve=True))  # type: ignore[arg-type]


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
