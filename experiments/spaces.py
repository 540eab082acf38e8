"""Search spaces of a method's settings, and trials that cover them.

Trial 0 is the present configuration. The others are an even grid where one setting is searched, and scrambled Sobol
points (Owen 1998) where several are; with more trials the first Sobol points stay what they were.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np
from scipy.stats import qmc

from retarget.check import InvalidInput
from retarget.suggest import choose


class Scale(StrEnum):
    """What is even along a range."""

    LOG = "log"
    LINEAR = "linear"


@dataclass(frozen=True)
class Range:
    """Numbers from low to high."""

    low: float
    high: float
    scale: Scale

    def at(self, share: float) -> float:
        """The number at a share in [0, 1] of the range, to two significant digits."""
        linear = self.scale is Scale.LINEAR
        exact = self.low + share * (self.high - self.low) if linear else self.low * (self.high / self.low) ** share
        return min(max(float(f"{exact:.1e}"), self.low), self.high)

    def __contains__(self, value: object) -> bool:
        return isinstance(value, float) and self.low <= value <= self.high

    def __str__(self) -> str:
        return f"[{self.low:g}, {self.high:g}]"


@dataclass(frozen=True)
class Choices:
    """Values without an order."""

    values: tuple[Any, ...]

    def at(self, share: float) -> Any:
        """The value at a share in [0, 1] of the list."""
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]

    def __contains__(self, value: object) -> bool:
        return value in self.values

    def __str__(self) -> str:
        return str(list(self.values))


@dataclass(frozen=True)
class Searched:
    """One setting that is searched. also: others that take the same value, each with its present one."""

    domain: Range | Choices
    present: Any
    also: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Trial:
    """values: of the searched settings. settings: the same with those that take the same value."""

    values: Mapping[str, Any]
    settings: Mapping[str, Any]


@dataclass(frozen=True)
class Space:
    """What is searched for one method."""

    method: str
    searched: Mapping[str, Searched]  # by setting

    @staticmethod
    def from_config(method: str, config: object, present: Mapping[str, Any]) -> Space:
        """Of `study.spaces.<method>` and the method's present settings. Raises InvalidInput for what is no space."""
        where = f"study.spaces.{method}"
        if not isinstance(config, Mapping) or not config:
            raise InvalidInput(
                f"{where}: expected settings, such as {{lambda_reg: {{log: [1e-8, 1]}}}}, got {config!r}."
            )
        settings = [name for name in present if not name.startswith("_")]
        searched = {}
        for name, described in config.items():
            choose(where, name, settings)
            searched[name] = _searched(f"{where}.{name}", described, name, {name: present[name] for name in settings})
        every = [name for setting, one in searched.items() for name in (setting, *one.also)]
        if twice := sorted({name for name in every if every.count(name) > 1}):
            raise InvalidInput(f"{where}: expected each setting once, got {', '.join(twice)} more than once.")
        return Space(method, searched)

    def trials(self, count: int, seed: int) -> tuple[Trial, ...]:
        """So many different trials; raises InvalidInput where the space has too few."""
        others = self._grid(count) if len(self.searched) == 1 else self._points(count - 1, seed)
        trials = (self._present, *map(self._trial, others))
        if len({tuple(trial.values.values()) for trial in trials}) < count:
            raise InvalidInput(
                f"study.spaces.{self.method}: expected {count} different trials, numbers to two significant digits, "
                "got fewer. Widen its ranges, or lower study.trials for all methods."
            )
        return trials

    def _grid(self, count: int) -> list[dict[str, Any]]:
        [(name, one)] = self.searched.items()
        grid = [one.domain.at(share) for share in np.linspace(0, 1, count)]
        if one.present not in grid:
            grid = [one.present, *(one.domain.at(share) for share in np.linspace(0, 1, count - 1))]
        return [{name: value} for value in dict.fromkeys(grid) if value != one.present]

    def _points(self, count: int, seed: int) -> list[dict[str, Any]]:
        if count < 1:
            return []
        sobol = qmc.Sobol(len(self.searched), scramble=True, seed=seed)
        points = [
            {name: one.domain.at(share) for (name, one), share in zip(self.searched.items(), point, strict=True)}
            for point in sobol.random_base2(math.ceil(math.log2(count + 1)))  # one more: the present may be among them
        ]
        present = self._present.values
        return [point for point in points if point != present][:count]

    @property
    def _present(self) -> Trial:
        every = {k: v for name, one in self.searched.items() for k, v in {name: one.present, **one.also}.items()}
        return Trial({name: one.present for name, one in self.searched.items()}, every)

    def _trial(self, values: Mapping[str, Any]) -> Trial:
        every = {setting: values[name] for name, one in self.searched.items() for setting in (name, *one.also)}
        return Trial(values, every)


def _searched(where: str, described: object, setting: str, present: Mapping[str, Any]) -> Searched:
    """One of {log: [low, high]}, {linear: [low, high]}, {choices: [...]}, with `also` beside it."""
    kinds = (*map(str, Scale), "choices")
    given = dict(described) if isinstance(described, Mapping) else {}
    also = given.pop("also", [])
    if len(given) != 1:
        raise InvalidInput(
            f"{where}: expected one of {', '.join(kinds)}, such as {{log: [0.1, 10]}}, got {described!r}."
        )
    [(kind, listed)] = given.items()
    choose(where, kind, kinds)
    if not isinstance(listed, list) or len(listed) < 2 or len(set(map(repr, listed))) < len(listed):
        raise InvalidInput(f"{where}.{kind}: expected a list of at least two different values, got {listed!r}.")
    domain = Choices(tuple(listed)) if kind == "choices" else _range(f"{where}.{kind}", Scale(kind), listed)
    if present[setting] not in domain:
        raise InvalidInput(
            f"{where}: expected a space that holds the present value, which is trial 0, got {domain} without "
            f"{present[setting]!r}. Widen it; whole numbers are searched as choices."
        )
    if not isinstance(also, list):
        raise InvalidInput(f"{where}.also: expected a list of settings, got {also!r}.")
    for name in also:
        choose(f"{where}.also", name, present)
    return Searched(domain, present[setting], {name: present[name] for name in also})


def _range(where: str, scale: Scale, listed: list[Any]) -> Range:
    numbers = all(isinstance(value, int | float) and math.isfinite(value) for value in listed)
    if not numbers or len(listed) != 2 or listed[0] >= listed[1]:
        raise InvalidInput(f"{where}: expected [low, high], finite numbers with low below high, got {listed!r}.")
    if scale is Scale.LOG and listed[0] <= 0:
        raise InvalidInput(f"{where}: expected positive numbers on a logarithmic scale, got {listed!r}; or use linear.")
    return Range(float(listed[0]), float(listed[1]), scale)
