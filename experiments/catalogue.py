"""What can be chosen: every option of every configuration group, each with a sentence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, cast

from hydra import compose, initialize_config_module
from hydra.core.global_hydra import GlobalHydra
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from rich.console import Console
from rich.table import Table

from retarget.check import InvalidInput, UnsupportedProblem
from retarget.suggest import choose
from retarget.types import Retargeter, RetargetProblem

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


@dataclass(frozen=True)
class MethodMaker:
    """A method that was chosen, with the settings that it was given; a study may turn some of them."""

    name: str
    settings: Mapping[str, Any]

    @staticmethod
    def of(name: str) -> MethodMaker:
        """The settings of ``conf/method/<name>.yaml``. Raises InvalidInput for an unknown name."""
        return MethodMaker(name, method_settings(name))

    def __call__(self, **turned: Any) -> Retargeter:
        """Raises InvalidInput for a method without such a setting."""
        for setting in turned:
            if setting not in self.settings:
                raise InvalidInput(
                    f"method: this study needs a method with the setting '{setting}', got {self.name}; "
                    "choose another with 'method=[NAME]', for example 'method=[anacondar]'."
                )
        return cast(Retargeter, instantiate(self.settings, **turned))

    def serving(self, problem: RetargetProblem, **turned: Any) -> Retargeter:
        """The method, where it serves a problem. Raises UnsupportedProblem with its reason where it does not."""
        method = self(**turned)
        if reason := method.unsupported(problem):
            raise UnsupportedProblem(f"method {self.name} cannot serve this dataset: {reason}")
        return method


def make_method(name: str, **turned: Any) -> Retargeter:
    """The method of ``conf/method/<name>.yaml``, tuned as there, with some settings changed.

    Raises InvalidInput for an unknown name or setting.
    """
    return MethodMaker.of(name)(**turned)


@cache
def method_settings(name: str) -> Mapping[str, Any]:
    """What ``conf/method/<name>.yaml`` says, with all that it inherits from the methods in its defaults list.

    Raises InvalidInput for an unknown name.
    """
    choose("method", name, options("method"))
    return cast(Mapping[str, Any], OmegaConf.to_container(composed(f"method/{name}").method[name]))


def composed(config_name: str, overrides: Sequence[str] = ()) -> DictConfig:
    """A configuration as Hydra composes it; also while a Hydra application runs, which is left as it was."""
    running = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        with initialize_config_module("experiments.conf", version_base="1.3"):
            return compose(config_name, list(overrides))
    finally:
        if running is not None:
            GlobalHydra.instance().initialize(running)


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
