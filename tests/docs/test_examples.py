"""The code in README.md and CONTRIBUTING.md runs as it stands."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import yaml

from experiments.metrics.metric import Comparison
from retarget.check import InvalidInput
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


def test_the_example_of_artistic_control_moves_a_corner_of_the_mouth(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = code_blocks("docs/artistic_control.md")
    exec(example, {})
    found = re.fullmatch(r"moved by up to (\d\.\d) mm\n", capsys.readouterr().out)
    assert found
    assert 3.5 < float(found[1]) < 5


def module_of(code: str, name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    module = ModuleType(name)
    monkeypatch.setitem(sys.modules, name, module)
    exec(code, module.__dict__)
    return module


def test_the_method_of_the_contributing_page_is_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    method = module_of(code_blocks("CONTRIBUTING.md")[0], "half_delta", monkeypatch).HalfDelta()
    data = toy(identities=2)
    problem = RetargetProblem(
        data.faces, data.neutral("a"), data.neutral("b"), data.frames("a", range(9)), np.empty((0, 642, 3))
    )
    frames = data.frames("a", [3])
    expected = data.neutral("b") + 0.5 * (frames - data.neutral("a"))
    np.testing.assert_allclose(method.retarget(problem, frames).frames, expected)
    fitted = method.prepare(problem.pair).fit(problem.examples, problem.source_animation)
    for broken in (frames[0], frames[:, :-1], np.full_like(frames, np.nan)):
        with pytest.raises(InvalidInput):
            fitted(broken)


def test_the_metric_of_the_contributing_page_is_a_metric(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = module_of(code_blocks("CONTRIBUTING.md")[1], "motion_ratio", monkeypatch).MotionRatio(["head"])
    data = toy(identities=1)
    neutral, truth = data.neutral("a"), data.frames("a", [3, 4])
    answers = {0.0: truth, 1.0: np.stack([neutral] * 2), 0.5: (truth + neutral) / 2}
    for value, answer in answers.items():
        (measured,) = metric(Comparison(answer, truth, truth, neutral, neutral, data.faces, data.regions))
        np.testing.assert_allclose(measured.values, value)


def test_the_configurations_of_the_contributing_page_have_a_sentence_and_name_their_package() -> None:
    pages = re.findall(r"```yaml\n(.*?)```", (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"), re.DOTALL)
    assert len(pages) == 3
    for page in pages:
        package, comment = page.splitlines()[:2]
        assert re.fullmatch(r"# @package (method|metric)\.\w+", package)
        assert comment.startswith("# ")
        assert comment.endswith(".")
        assert yaml.safe_load(page).keys() & {"_target_", "defaults"}
