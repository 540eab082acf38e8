"""One thread against two."""

from collections.abc import Callable
from typing import TypeVar

import numba
import pytest

T = TypeVar("T")


def with_one_and_two_threads(compute: Callable[[], T]) -> tuple[T, T]:
    """Both results; skips the test where numba was started with one thread, as then there is nothing to compare."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("needs two threads, but there is one core or NUMBA_NUM_THREADS=1")
    before = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = compute()
        numba.set_num_threads(2)
        return one, compute()
    finally:
        numba.set_num_threads(before)
