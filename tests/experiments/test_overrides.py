import pytest

from experiments.catalogue import GROUPS, options, sentence
from experiments.overrides import check_overrides
from retarget.check import InvalidInput


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["study=ci", "scale=full", "backend=serial", "report=false"],
        ["method=[plbs,delta]", "method.plbs.lambda_reg=0.1"],
        ["-m", "method.plbs.lambda_reg=0.1,1"],
        ["-m", "study=ci,quantitative"],
        ["--cfg", "job"],
        ["+method.plbs.note=1", "paths.results=/somewhere", "hydra.verbose=true"],
        ["dataset.identities=3", "study.n_examples=[5]"],
    ],
)
def test_valid_command_lines_pass(arguments: list[str]) -> None:
    check_overrides("run", arguments)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["study=quantitativ"], "study: 'quantitativ' is unknown, .* Did you mean 'quantitative'"),
        (["method=[plbs,lbz]"], "method: 'lbz' is unknown, .* Did you mean 'lbs'"),
        (["-m", "study=ci,quantitative,cii"], "'cii' is unknown"),
        (["dataset=makehumn"], "Did you mean 'makehuman'"),
        (["study.n_exmples=[5]"], "'study.n_exmples' is no setting .* Did you mean 'study.n_examples'"),
        (["method.plbs.lamda_reg=1"], "Did you mean 'method.plbs.lambda_reg'"),
        (["studdy=ci"], "Did you mean 'study'"),
        (["study.n_examples=[5"], "cannot read the command line"),
    ],
)
def test_misspelt_ones_are_refused_with_the_nearest_valid_one(arguments: list[str], words: str) -> None:
    with pytest.raises(InvalidInput, match=words):
        check_overrides("run", arguments)


def test_every_option_of_every_group_has_a_sentence() -> None:
    for group in GROUPS:
        assert options(group)
        for name in options(group):
            assert sentence(group, name).endswith("."), (group, name)
