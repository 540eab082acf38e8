"""A user study: make a questionnaire from a finished study, or analyse the rankings that raters returned."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from experiments.progress import print_line, print_path
from reports.load import StudyResults, load
from reports.questionnaire import Design, questionnaire, read_key, write_key
from reports.questionnaire_form import write_form
from reports.rankings import read_rankings
from reports.rankings_sheet import build_rankings_sheet
from retarget.check import InvalidInput
from retarget.io.files import check_folder
from retarget.suggest import choose

FOR_RATERS = "for_raters"
KEY = "key.json"


def survey(config: DictConfig, results: Path, console: Console) -> None:
    """Make the questionnaire, or, where `rankings` is set, its analysis. Raises InvalidInput with what to do."""
    study = Path(config.input).absolute() if config.input else results
    folder = Path(config.output).absolute() if config.output else study / f"survey_{config.questionnaire.name}"
    if config.rankings is None:
        _make(config, study, folder, console)
    else:
        _analyse(config, folder, console)


def _make(config: DictConfig, study: Path, folder: Path, console: Console) -> None:
    if not isinstance(config.width, int) or not 50 <= config.width <= 2000:
        raise InvalidInput(f"width: expected a whole number of pixels from 50 to 2000, got {config.width!r}.")
    design = Design.from_config(_plain(config.questionnaire))
    made = questionnaire(_study(study, config.correspondence), design)
    check_folder(folder)
    write_key(folder / KEY, made.key)
    for path in write_form(
        made,
        folder / FOR_RATERS,
        (config.width, round(config.width * 14 / 11)),
        lambda line: console.print(f"  {line}"),
    ):
        print_path(path, console)
    print_path(folder / KEY, console)
    items = f"{len(made.shown)} items"
    print_line(f"{items}, {made.sparse}" if made.sparse else items, console)
    print_line(
        f"Give raters {FOR_RATERS}, keep {KEY} from them. When their files are back:\n"
        f"python -m experiments survey rankings=FOLDER key={folder / KEY}",
        console,
    )


def _study(folder: Path, correspondence: str | None) -> StudyResults:
    """The one study of a folder. Raises InvalidInput where there are several."""
    found = load([folder])
    if len({study.folder for study in found}) > 1:
        raise InvalidInput(
            f"{folder}: this folder holds {len(found)} results folders, expected one; choose with input=FOLDER, for "
            f"example input={found[0].folder}."
        )
    names = [str(study.cells["correspondence"].iloc[0]) for study in found]
    if len(found) > 1 and correspondence is None:
        raise InvalidInput(
            f"{folder}: this study has the correspondences {', '.join(names)}, expected one; choose with "
            f"correspondence={names[0]}."
        )
    return found[names.index(choose("correspondence", correspondence or names[0], names))]


def _analyse(config: DictConfig, folder: Path, console: Console) -> None:
    key = read_key(Path(config.key).absolute() if config.key else folder / KEY)
    given = config.rankings if isinstance(config.rankings, str) else list(config.rankings)
    files = [Path(given)] if isinstance(given, str) else [Path(name) for name in given]
    rankings = read_rankings(files, key, config.delimiter, config.ties, config.incomplete)
    check_folder(folder)
    for path in build_rankings_sheet(rankings, folder):
        print_path(path, console)


def _plain(node: DictConfig) -> dict[str, Any]:
    return dict(OmegaConf.to_container(node, resolve=True))  # type: ignore[arg-type]
