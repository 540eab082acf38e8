"""The command line: each subcommand is a Hydra application of its own."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from rich.console import Console

from experiments.overrides import check_overrides
from retarget.check import InvalidInput
from retarget.suggest import choose

USAGE = """\
Offline facial retargeting: an honest comparison of methods.

  python -m experiments run      run a study, write its tables and its report PDF
  python -m experiments report   build the report again, or one report of several results folders
  python -m experiments gate     compare a finished study with the accuracy gates under version control
  python -m experiments list     methods, datasets, studies, metrics: a sentence each

`python -m experiments COMMAND --help` shows every setting of a command.
"""
HYDRA_MAIN = {"config_path": "pkg://experiments.conf", "version_base": "1.3"}


def main() -> None:
    """Pop the subcommand and hand the rest of the command line to its Hydra application."""
    if len(sys.argv) < 2 or sys.argv[1] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0 if len(sys.argv) > 1 else 2)
    with_readable_errors(_dispatch)()


def _dispatch() -> None:
    command = choose("command", sys.argv.pop(1), COMMANDS)
    sys.argv[0] = f"python -m experiments {command}"
    check_overrides(command, sys.argv[1:])
    COMMANDS[command]()


def with_readable_errors(function: Callable[..., None]) -> Callable[..., None]:
    """What a user can mend is told in words, without a traceback, with exit status 1."""

    @wraps(function)
    def guarded(*arguments: object) -> None:
        try:
            function(*arguments)
        except InvalidInput as error:
            Console(stderr=True).print(f"error: {error}", style="red", markup=False, highlight=False, soft_wrap=True)
            sys.exit(1)
        except KeyboardInterrupt:
            Console(stderr=True).print("interrupted; the same command continues where this one stopped")
            sys.exit(130)

    return guarded


def results_folder(config: DictConfig) -> Path:
    """<results>/<study>, and below it a folder of its own for each job of a sweep."""
    folder = Path(config.paths.results).absolute() / config.study.name
    job = HydraConfig.get()
    return folder / job.sweep.subdir if job.mode == RunMode.MULTIRUN else folder


@hydra.main(config_name="run", **HYDRA_MAIN)
@with_readable_errors
def run(config: DictConfig) -> None:
    from experiments.run import run as run_study

    run_study(config, results_folder(config), Console())


@hydra.main(config_name="report", **HYDRA_MAIN)
@with_readable_errors
def report(config: DictConfig) -> None:
    from reports.report import build_report

    console = Console()
    inputs = [Path(folder).absolute() for folder in config.inputs or [f"{config.paths.results}/{config.study}"]]
    output = Path(config.output).absolute() if config.output else None
    console.print(f"{build_report(inputs, output, console.print)}", soft_wrap=True)


@hydra.main(config_name="gate", **HYDRA_MAIN)
@with_readable_errors
def gate(config: DictConfig) -> None:
    from experiments.gate import gate as check

    folder = Path(config.paths.results).absolute() / config.study
    if not check(folder, config, Console()):
        sys.exit(1)


@hydra.main(config_name="list", **HYDRA_MAIN)
@with_readable_errors
def list_options(config: DictConfig) -> None:
    from experiments.catalogue import print_catalogue

    print_catalogue(Console())


COMMANDS: dict[str, Callable[[], None]] = {"run": run, "report": report, "gate": gate, "list": list_options}
