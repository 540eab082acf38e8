"""The code in README.md and CONTRIBUTING.md runs as it stands."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from retarget.types import RetargetProblem
from tests.experiments.toy import toy

ROOT = Path(__file__).parents[2]


def code_blocks(page: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.DOTALL)


def test_the_readme_example_retargets_and_prints_its_error(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = code_blocks("README.md")
    exec(example, {})
    found = re.fullmatch(r"mean vertex error (\d\.\d\d) mm\n", capsys.readouterr().out)
    assert found
    assert 0 < float(found[1]) < 2


def test_the_method_of_the_contributing_page_is_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    (example,) = code_blocks("CONTRIBUTING.md")
    module = ModuleType("half_delta")
    monkeypatch.setitem(sys.modules, "half_delta", module)
    exec(example, module.__dict__)
    data = toy(identities=2)
    problem = RetargetProblem(
        data.faces, data.neutral("a"), data.neutral("b"), data.frames("a", range(9)), np.empty((0, 642, 3))
    )
    frames = data.frames("a", [3])
    expected = data.neutral("b") + 0.5 * (frames - data.neutral("a"))
    np.testing.assert_allclose(module.HalfDelta().retarget(problem, frames).frames, expected)
