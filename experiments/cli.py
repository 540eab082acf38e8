"""The command line: each subcommand is a Hydra application of its own."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import NoReturn

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from hydra.types import RunMode
from omegaconf import DictConfig
from rich.console import Console

from experiments.overrides import check_overrides
from experiments.progress import print_line, print_path
from retarget.check import InvalidInput
from retarget.suggest import choose

USAGE = """\
Offline facial retargeting: an honest comparison of methods.

  python -m experiments run      run a study, write its tables and its report, as PDF and page
  python -m experiments report   build the report again, or one report of several results folders
  python -m experiments export   faces that perform as glTF, OBJ sequence or NPZ: truth, rigs, retargeted animation
  python -m experiments gate     compare a finished study with the accuracy gates under version control
  python -m experiments survey   make a ranking questionnaire of a finished study, or analyse what raters returned
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
    if command == "report":
        sys.argv[1:] = with_inputs(sys.argv[1:])
    sys.argv[0] = f"python -m experiments {command}"
    sys.argv += check_overrides(command, sys.argv[1:])
    COMMANDS[command]()


def with_inputs(arguments: list[str]) -> list[str]:
    """Folders among the arguments as the setting `inputs`: ``report results/a results/b``."""
    folders = [a for a in arguments if "=" not in a and not a.startswith(("-", "~", "+")) and Path(a).is_dir()]
    if not folders:
        return arguments
    quoted = ",".join("'{}'".format(folder.replace("'", r"\'")) for folder in folders)
    return [a for a in arguments if a not in folders] + [f"inputs=[{quoted}]"]


def with_readable_errors(function: Callable[..., None]) -> Callable[..., None]:
    """What a user can mend is told in words, without a traceback, with exit status 1."""

    @wraps(function)
    def guarded(*arguments: object) -> None:
        try:
            function(*arguments)
        except InvalidInput as error:
            _exit_with(str(error))
        except InstantiationException as error:
            _exit_with(str(error.__cause__) if isinstance(error.__cause__, InvalidInput) else _setting(error))
        except KeyboardInterrupt:
            Console(stderr=True).print("interrupted; the same command continues where this one stopped")
            sys.exit(130)

    return guarded


def _exit_with(message: str) -> NoReturn:
    Console(stderr=True).print(f"error: {message}", style="red", markup=False, highlight=False, soft_wrap=True)
    sys.exit(1)


def _setting(error: InstantiationException) -> str:
    """Hydra's message says which node of the configuration; its cause says why it cannot be made."""
    where = re.search(r"full_key: (\S+)", str(error))
    return f"{where[1] if where else 'configuration'}: cannot be made from its settings: {error.__cause__}"


def results_folder(config: DictConfig) -> Path:
    """<results>/<study>, or for each job of a sweep a folder of its own in <results>/<study>/sweep."""
    job = HydraConfig.get()
    if job.mode == RunMode.MULTIRUN:
        return Path(job.sweep.dir).absolute() / job.sweep.subdir
    return Path(config.paths.results).absolute() / config.study.name


@hydra.main(config_name="run", **HYDRA_MAIN)
@with_readable_errors
def run(config: DictConfig) -> None:
    from experiments.run import run as run_study

    run_study(config, results_folder(config), Console())


@hydra.main(config_name="report", **HYDRA_MAIN)
@with_readable_errors
def report(config: DictConfig) -> None:
    from reports.report import build_report
    from reports.temporal_sheet import build_temporal_sheet, temporal_folders
    from reports.tuning_sheet import build_tuning_sheet

    console = Console()
    if config.study.kind == "tuning" and not config.inputs:
        print_path(build_tuning_sheet(results_folder(config)), console)
        return
    inputs = [Path(folder).absolute() for folder in config.inputs or finished_folders(config)]
    output = Path(config.output).absolute() if config.output else None
    if output is None and not config.inputs:
        output = results_folder(config) / "report.pdf"
    for folder in temporal_folders(inputs):
        print_path(build_temporal_sheet(folder), console)
    path = build_report(inputs, output, lambda line: print_line(line, console))
    for written in (path, path.with_suffix(".html")):
        print_path(written, console)


@hydra.main(config_name="export", **HYDRA_MAIN)
@with_readable_errors
def export(config: DictConfig) -> None:
    from experiments.export.command import export as write

    write(config, Console())


def finished_folders(config: DictConfig) -> list[Path]:
    """The study's results: one folder, or one for each condition that is finished, in the study's order."""
    folder = results_folder(config)
    conditions = [folder / name for name in config.study.get("conditions", ())]
    return [each for each in conditions if (each / "study.json").exists()] or [folder]


@hydra.main(config_name="gate", **HYDRA_MAIN)
@with_readable_errors
def gate(config: DictConfig) -> None:
    from experiments.gate import gate as check

    folder = Path(config.paths.results).absolute() / config.study.name
    if not check(folder, config, Console()):
        sys.exit(1)


@hydra.main(config_name="survey", **HYDRA_MAIN)
@with_readable_errors
def survey(config: DictConfig) -> None:
    from experiments.survey import survey as make_or_analyse

    make_or_analyse(config, Path(config.paths.results).absolute() / config.study.name, Console())


@hydra.main(config_name="list", **HYDRA_MAIN)
@with_readable_errors
def list_options(config: DictConfig) -> None:
    from experiments.catalogue import print_catalogue

    print_catalogue(Console())


COMMANDS: dict[str, Callable[[], None]] = {
    "run": run,
    "report": report,
    "export": export,
    "gate": gate,
    "survey": survey,
    "list": list_options,
}
