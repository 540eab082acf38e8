"""Tests compute on one core: several workers with several threads each would wait for one another, ten times longer."""

from __future__ import annotations

import os
from collections.abc import Iterator

import numba
import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="session")
def one_thread(request: pytest.FixtureRequest) -> Iterator[None]:
    """Also in the programs that tests start; benchmarks have all cores."""
    if request.config.getoption("--benchmark-only"):
        yield
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    numba.set_num_threads(1)
    with threadpool_limits(limits=1):
        yield
