"""Where the tasks of a study run. A backend yields results in the order in which they finish."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, TypeVar

import joblib
from threadpoolctl import threadpool_limits

from retarget.check import InvalidInput, check_whole

Task = TypeVar("Task")
Result = TypeVar("Result")


class Backend(Protocol):
    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """function must live in an importable module; an exception in a task is raised here."""
        ...


@dataclass(frozen=True)
class Serial:
    threads: int = 1

    def __post_init__(self) -> None:
        check_whole("backend.threads", self.threads, 1)

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        for task in tasks:
            yield _limited(function, task, self.threads)


@dataclass(frozen=True)
class Joblib:
    jobs: int = -1
    threads: int = 1

    def __post_init__(self) -> None:
        if isinstance(self.jobs, bool) or not isinstance(self.jobs, int) or self.jobs == 0:
            raise InvalidInput(
                "backend.jobs: expected a whole number of at least 1, -1 for every core or -2 for all but one, got "
                f"{self.jobs!r}."
            )
        check_whole("backend.threads", self.threads, 1)

    def run(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        parallel = joblib.Parallel(n_jobs=self.jobs, return_as="generator_unordered", pre_dispatch="2*n_jobs")
        yield from parallel(joblib.delayed(_limited)(function, task, self.threads) for task in tasks)


def _limited(function: Callable[[Task], Result], task: Task, threads: int) -> Result:
    with limited_threads(threads):
        return function(task)


@contextmanager
def limited_threads(threads: int) -> Iterator[None]:
    """Numerical libraries, and the simulation where it is loaded, use at most so many threads."""
    numba = sys.modules.get("numba")
    before = numba.get_num_threads() if numba else 0
    if numba:
        numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))
    try:
        with threadpool_limits(limits=threads):
            yield
    finally:
        if numba:
            numba.set_num_threads(before)
