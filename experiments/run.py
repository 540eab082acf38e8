"""Run a study: plan it, compute the cells that are missing, write its tables and its report."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from experiments.compute import compute
from experiments.metrics.metric import Metric
from experiments.plan import plan
from experiments.record import check_folder
from experiments.study import Row, Study
from experiments.tables import collect, write_tables
from reports.report import build_report
from reports.terminal import print_summary
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
    summary = write_tables(planned, collect(planned), _plain(config), started)
    print_summary(summary, console, metric=study.primary_metric, region=study.primary_region)
    for name in ("metrics.parquet", "summary.csv"):
        console.print(f"{folder / name}", soft_wrap=True)
    if config.report:
        report = build_report([folder], None, lambda line: console.print(f"  {line}"))
        console.print(f"{report}", soft_wrap=True)


def _method(name: Any, node: DictConfig) -> Retargeter:
    method = instantiate(node)
    if not isinstance(method, Retargeter):
        raise InvalidInput(
            f"method {name}: {node.get('_target_')} makes a {type(method).__name__}, expected a Retargeter."
        )
    return method


def _plain(node: DictConfig) -> dict[str, Any]:
    return dict(OmegaConf.to_container(node, resolve=True))  # type: ignore[arg-type]
