"""What can be chosen: every option of every configuration group, each with a sentence."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.console import Console
from rich.table import Table

from retarget.suggest import choose
from retarget.types import Retargeter

GROUPS = ("study", "method", "dataset", "metric", "scale", "backend")
CONF = Path(str(files("experiments") / "conf"))


def options(group: str) -> list[str]:
    """The names in ``conf/<group>``."""
    return sorted(path.stem for path in (CONF / group).glob("*.yaml"))


def sentence(group: str, name: str) -> str:
    """The first comment of the option's YAML that is no Hydra directive."""
    for line in (CONF / group / f"{name}.yaml").read_text(encoding="utf-8").splitlines():
        if line.startswith("#") and not line.startswith("# @package"):
            return line.lstrip("# ").strip()
    return ""


def make_method(name: str, **settings: Any) -> Retargeter:
    """The method of ``conf/method/<name>.yaml``, tuned as there, with some settings changed.

    Raises InvalidInput for an unknown name.
    """
    config = OmegaConf.load(CONF / "method" / f"{choose('method', name, options('method'))}.yaml")
    return cast(Retargeter, instantiate(config, **settings))


def print_catalogue(console: Console) -> None:
    """The whole catalogue as one table for each group."""
    for group in GROUPS:
        table = Table(title=f"{group}", title_justify="left", box=None, show_header=False, title_style="bold")
        table.add_column(no_wrap=True, style="cyan")
        table.add_column(overflow="fold")
        for name in options(group):
            table.add_row(name, sentence(group, name))
        console.print(table)
        console.print()
