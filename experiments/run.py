"""Run a study: plan it, compute the cells that are missing, write its tables and its report."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import pandas as pd
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from experiments.alm_leave_out import LeaveOutStudy, leave_out
from experiments.alm_overlap import OverlapStudy, vary
from experiments.alm_shapes import ShapesStudy, grow
from experiments.artistic import ArtisticStudy, intervene
from experiments.catalogue import MethodMaker
from experiments.collision import CollisionStudy, collide
from experiments.compute import compute, estimate
from experiments.conditions import by_condition, said
from experiments.identities import check_identities
from experiments.metrics.metric import Metric
from experiments.plan import Plan, plan
from experiments.progress import print_line, print_path
from experiments.runtime import RuntimeStudy, measure
from experiments.study import Study
from experiments.tables import collect, write_tables
from experiments.temporal import TemporalStudy, write_animation
from experiments.tuning import Tuning, chosen_yaml, trial_table
from reports.cells import FINISHED
from reports.report import build_report
from reports.terminal import print_solves, print_summary, print_tuning
from reports.tuning_sheet import build_tuning_sheet
from retarget.check import InvalidInput
from retarget.io.files import check_folder, write_whole
from retarget.suggest import choose
from synth_data.dataset import Dataset


def run(config: DictConfig, folder: Path, console: Console) -> None:
    """The main job. Raises InvalidInput with what to do if the configuration or the data cannot be used."""
    check_folder(folder)
    kind = choose("study.kind", config.study.kind, KINDS)
    check_identities(_plain(config.dataset), tuning=kind == "tuning")
    instantiate(config.backend)  # checked before data is made
    KINDS[kind](config, folder, console)


def _compare(config: DictConfig, folder: Path, console: Console) -> None:
    _tell(_finished(_planned(_compared(config), config, folder, console), config, console), folder, console)
    if config.report:
        _report([folder], None, console)


def _compare_conditions(config: DictConfig, folder: Path, console: Console) -> None:
    """Everything is planned before anything is computed: a condition that cannot be is found at once."""
    conditions, plans = by_condition(config), {}
    for name, condition in conditions.items():
        print_line(f"condition {name}: {said(config.study.conditions[name])}", console)
        plans[name] = _planned(_compared(condition), condition, folder / name, console)
    every = list(plans.values())
    console.print(f"{len(plans)} conditions, {sum(len(planned.cells) for planned in every)} cells; {estimate(every)}")
    for i, (name, planned) in enumerate(plans.items()):
        print_line(f"\ncondition {name} ({i + 1} of {len(plans)})", console)
        _tell(_finished(planned, conditions[name], console, every), folder / name, console)
    if config.report:
        _report([folder / name for name in plans], folder / "report.pdf", console)


def _compared(config: DictConfig) -> Study:
    described = _study(config)
    return Study.from_config(described | {"reference": _reference(described["reference"], config)})


def _tell(finished: Finished, folder: Path, console: Console) -> None:
    study = finished.study
    print_summary(finished.summary, console, metric=study.primary_metric, region=study.primary_region)
    print_solves(finished.cells, console)
    for name in ("metrics.parquet", "summary.csv"):
        print_path(folder / name, console)


def _report(folders: Sequence[Path], output: Path | None, console: Console) -> None:
    path = build_report(folders, output, lambda line: console.print(f"  {line}"))
    for written in (path, path.with_suffix(".html")):
        print_path(written, console)


def _follow(config: DictConfig, folder: Path, console: Console) -> None:
    described = _study(config)
    study = TemporalStudy.from_config(described | {"reference": _reference(described["reference"], config)})
    planned = _planned(study, config, folder, console)
    _tell(_finished(planned, config, console), folder, console)
    for path in write_animation(study, planned):
        print_path(path, console)
    if config.report:
        _report([folder], None, console)


def _reference(wanted: str | list[str], config: DictConfig) -> str:
    """`study.reference`: a row, or a list of methods of which the first that was chosen is taken, or else any."""
    if isinstance(wanted, str):
        return wanted
    chosen = [name for name, _ in _chosen(config, "method")]
    return next((name for name in wanted if name in chosen), chosen[0])


def _tune(config: DictConfig, folder: Path, console: Console) -> None:
    tuning = Tuning.from_config(_study(config), dict(_chosen(config, "method")))
    finished = _finished(_planned(tuning.study, config, folder, console), config, console)
    trials = trial_table(tuning, finished.metrics, finished.cells)
    lines = chosen_yaml(tuning, trials)
    write_whole(folder / "trials.csv", lambda temporary: trials.to_csv(temporary, index=False))
    write_whole(folder / "chosen.yaml", lambda temporary: temporary.write_text(lines))
    print_tuning(trials, console)
    print_solves(finished.cells, console)
    console.print("\nfor experiments/conf/method, nothing there was changed:\n")
    console.print(lines, markup=False, highlight=False)
    for name in ("trials.csv", "chosen.yaml"):
        print_path(folder / name, console)
    if config.report:
        print_path(build_tuning_sheet(folder), console)


@dataclass(frozen=True)
class Finished:
    """The tables of a study of rows and pairs."""

    study: Study
    metrics: pd.DataFrame
    cells: pd.DataFrame
    summary: pd.DataFrame


def _planned(study: Study, config: DictConfig, folder: Path, console: Console) -> Plan:
    """A study of rows and pairs, with its data loaded and everything checked."""
    methods = study.rows(dict(_chosen(config, "method")))
    study.check_rows([row.name for row in methods])
    metrics = {name: (cast(Metric, instantiate(settings)), settings) for name, settings in _chosen(config, "metric")}
    dataset = study.data(_dataset(config, console))
    return plan(study, dataset, methods, metrics, folder)


def _finished(planned: Plan, config: DictConfig, console: Console, alike: Sequence[Plan] = ()) -> Finished:
    """Compute every cell that is missing, and write the tables."""
    started = datetime.now(UTC)
    compute(planned, instantiate(config.backend), console, alike)
    tables = collect(planned)
    served = replace(planned, study=_with_a_reference(planned.study, config.study.reference, tables[1], console))
    return Finished(served.study, *tables, write_tables(served, tables, _plain(config), started))


def _with_a_reference(study: Study, wanted: str | Sequence[str] | None, cells: pd.DataFrame, console: Console) -> Study:
    """Where `wanted` lists several, and the reference has no result on this dataset, the next that has one."""
    if wanted is None or isinstance(wanted, str):
        return study
    served = [name for name in cells.loc[cells["status"].isin(FINISHED), "method"] if name not in study.references]
    others = [name for name in [*wanted, *served] if name in served]
    if study.reference in served or not others:
        return study
    print_line(f"{study.reference} has no result on this dataset: every row is compared with {others[0]}", console)
    return replace(study, reference=others[0])


def _measure(config: DictConfig, folder: Path, console: Console) -> None:
    study = RuntimeStudy.from_config(_study(config))
    measure(study, only_method(config), _dataset(config, console), config.backend.threads, folder, console)


def _collide(config: DictConfig, folder: Path, console: Console) -> None:
    study = CollisionStudy.from_config(_study(config))
    collide(study, only_method(config), _dataset(config, console), config.backend.threads, folder, console)


def _intervene(config: DictConfig, folder: Path, console: Console) -> None:
    study = ArtisticStudy.from_config(_study(config))
    intervene(study, only_method(config), _dataset(config, console), config.backend.threads, folder, console)


def makers(config: DictConfig) -> list[MethodMaker]:
    """The chosen methods with their settings."""
    return [MethodMaker(name, settings) for name, settings in _chosen(config, "method")]


def only_method(config: DictConfig) -> MethodMaker:
    """The one method of a study of one. Raises InvalidInput for more."""
    chosen = makers(config)
    if len(chosen) != 1:
        raise InvalidInput(
            f"method: study {config.study.name} shows one method, got {', '.join(maker.name for maker in chosen)}; "
            "choose it with 'method=[NAME]'."
        )
    return chosen[0]


def _grow(config: DictConfig, folder: Path, console: Console) -> None:
    study = ShapesStudy.from_config(_study(config))
    grow(study, makers(config), _dataset(config, console), config.backend.threads, folder, console)


def _vary(config: DictConfig, folder: Path, console: Console) -> None:
    study = OverlapStudy.from_config(_study(config))
    vary(study, only_method(config), _dataset(config, console), config.backend.threads, folder, console)


def _leave_out(config: DictConfig, folder: Path, console: Console) -> None:
    study = LeaveOutStudy.from_config(_study(config))
    leave_out(study, makers(config), _dataset(config, console), config.backend.threads, folder, console)


KINDS: dict[str, Callable[[DictConfig, Path, Console], None]] = {
    "comparison": _compare,
    "conditions": _compare_conditions,
    "tuning": _tune,
    "temporal": _follow,
    "runtime": _measure,
    "collision": _collide,
    "artistic": _intervene,
    "alm_shapes": _grow,
    "alm_overlap": _vary,
    "alm_leave_out": _leave_out,
}


def _study(config: DictConfig) -> dict[str, Any]:
    return {name: value for name, value in _plain(config.study).items() if name != "kind"}


def _dataset(config: DictConfig, console: Console) -> Dataset:
    dataset: Dataset = instantiate(config.dataset).load(lambda line: print_line(f"  {line}", console))
    return dataset


def _chosen(config: DictConfig, group: str) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Name and settings of each chosen option of a group. Raises InvalidInput where there is none."""
    chosen = config.get(group)
    if not chosen:
        raise InvalidInput(f"{group}: expected at least one, got none; choose with '{group}=[NAME,NAME]'.")
    yield from _plain(chosen).items()


def _plain(node: DictConfig) -> dict[str, Any]:
    return dict(OmegaConf.to_container(node, resolve=True))  # type: ignore[arg-type]
