"""One comparison under several conditions of its data: named sets of dataset settings, each in a folder of its own."""

from __future__ import annotations

import re
from collections.abc import Mapping

from omegaconf import DictConfig, OmegaConf

from experiments.catalogue import CONF, options
from retarget.check import InvalidInput
from retarget.suggest import choose

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*")  # also a key on the command line


def by_condition(config: DictConfig) -> dict[str, DictConfig]:
    """The configuration of the comparison under each condition, in the order of `study.conditions`.

    Raises InvalidInput unless that is {NAME: {SETTING: VALUE}}, with names for folders and settings of the dataset.
    """
    listed = OmegaConf.to_container(config.study.conditions, resolve=True) if config.study.get("conditions") else None
    if not isinstance(listed, Mapping):
        raise InvalidInput(
            "study.conditions: expected settings of the dataset by the names of the conditions, such as "
            f"{{quiet: {{noise_mm: 0.0}}, noisy: {{noise_mm: 0.3}}}}, got {listed!r}."
        )
    names = [str(name) for name in listed]
    return {name: _under(config, name, settings, names) for name, settings in zip(names, listed.values(), strict=True)}


def said(settings: Mapping[str, object]) -> str:
    """What a condition sets, in words."""
    return ", ".join(f"{key} = {value}" for key, value in settings.items())


def _datasets_with(key: str) -> list[str]:
    """The datasets that have such a setting."""
    return [name for name in options("dataset") if key in OmegaConf.load(CONF / "dataset" / f"{name}.yaml")]


def _under(config: DictConfig, name: str, settings: object, names: list[str]) -> DictConfig:
    where = f"study.conditions.{name}"
    if not _NAME.fullmatch(name):
        raise InvalidInput(f"{where}: expected a name of letters, digits, '_' and '-', a letter first.")
    if not isinstance(settings, Mapping) or not settings:
        raise InvalidInput(f"{where}: expected settings of the dataset, such as {{noise_mm: 0.3}}, got {settings!r}.")
    for key in map(str, settings):
        if key not in config.dataset and (others := _datasets_with(key)):
            raise InvalidInput(
                f"study={config.study.name} compares values of the setting '{key}', which the chosen dataset has not. "
                f"Choose one that has it: dataset={' or dataset='.join(others)}."
            )
        choose(f"{where}, setting of the dataset", key, [key for key in map(str, config.dataset) if key[0] != "_"])
    comparison = OmegaConf.merge(config, {"dataset": dict(settings)})
    assert isinstance(comparison, DictConfig)
    OmegaConf.set_struct(comparison, False)
    comparison.study.kind = "comparison"
    comparison.study.pop("conditions")
    comparison.conditions = names  # the order in which a report shows them
    return comparison
