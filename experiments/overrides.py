"""Overrides are checked before Hydra composes them, so that a misspelt one is refused with the nearest valid one."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Quote, QuotedString
from hydra.errors import HydraException
from omegaconf import DictConfig

from experiments.catalogue import GROUPS, composed, options
from retarget.check import InvalidInput
from retarget.io.files import check_folder
from retarget.suggest import choose, nearest

CHOICES = {
    "run": GROUPS,
    "report": ("study", "scale"),
    "export": ("method", "dataset", "scale"),
    "gate": ("study", "scale"),
    "survey": ("study", "scale", "questionnaire"),
    "list": (),
}
_HYDRA_GROUPS = ("hydra", "paths")


def check_overrides(config_name: str, arguments: Sequence[str]) -> list[str]:
    """What Hydra must be told besides `arguments`: the name of a sweep's folders is made of the swept keys alone.

    Raises InvalidInput for an unknown option of a group, or a key that the chosen options do not have, and for a
    sweep into a folder that cannot be written, because Hydra makes that folder before any code of ours runs.
    """
    parsed = get_args_parser().parse_args(list(arguments))
    overrides = [_parsed(argument) for argument in parsed.overrides]
    groups = CHOICES[config_name]
    choices = [override for override in overrides if override.key_or_group in groups]
    for override in choices:
        for name in _chosen(override):
            choose(override.key_or_group, name, options(override.key_or_group))
    keys = set(_keys(composed(config_name, [_first(override) for override in choices])))
    for override in overrides:
        key = override.key_or_group
        plain = not (override.is_add() or override.is_force_add() or override.is_delete())
        if plain and key not in groups and key.split(".")[0].split("/")[0] not in _HYDRA_GROUPS and key not in keys:
            raise InvalidInput(
                f"'{key}' is no setting of this command.{nearest(key, [*keys, *groups])} "
                f"`python -m experiments {config_name} --cfg job` prints all settings."
            )
    if not parsed.multirun:
        return []
    folders = [str(override.value()) for override in overrides if override.key_or_group == "paths.results"]
    check_folder(Path(folders[-1] if folders else "results"))
    fixed = [override.key_or_group for override in overrides if not override.is_sweep_override()]
    return [f"hydra.job.config.override_dirname.exclude_keys=[{','.join(fixed)}]"]


def _parsed(argument: str) -> Override:
    try:
        (override,) = OverridesParser.create().parse_overrides([argument])
    except HydraException as error:
        key, _, value = argument.partition("=")
        raise InvalidInput(
            f"cannot read the command line at {argument} (settings are written KEY=VALUE). A value with blanks, "
            "umlauts, brackets, commas, '=' or other special characters needs quotes within quotes, as in "
            f"{_quoted(key, value)}"
        ) from error
    return override


def _quoted(key: str, value: str) -> str:
    """A value as both the shell and Hydra read it; for what looks like a list, or like no value, an example."""
    if not value or value[0] in "[{\"'":
        return "'inputs=[\"results/a=1\"]'"
    return shlex.quote(f"{key}={QuotedString(value, Quote.double).with_quotes()}")


def _chosen(override: Override) -> Iterator[str]:
    """Every option that an override (or a sweep over it) names."""
    values = override.sweep_iterator() if override.is_sweep_override() else [override.value()]
    for value in values:
        for name in value if isinstance(value, list) else [value]:
            yield str(name).strip("'\"[] ")


def _first(override: Override) -> str:
    """The override itself, or the first choice of a sweep."""
    if not override.is_sweep_override():
        return str(override.input_line)
    return f"{override.key_or_group}={next(override.sweep_string_iterator())!s}"


def _keys(config: DictConfig, prefix: str = "") -> Iterator[str]:
    for name in map(str, config):
        yield f"{prefix}{name}"
        node = config._get_node(name)
        if isinstance(node, DictConfig):
            yield from _keys(node, f"{prefix}{name}.")
