import shlex

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

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


@pytest.mark.parametrize(
    "value",
    [
        "/data/Müller/take 7.csv",
        "take (2).csv",
        "a=b/take.csv",
        "it's fünf.csv",
        'take "5" ü.csv',
        "ü\\",
        "take#1,é.csv",
    ],
)
def test_a_value_that_needs_quotes_is_given_back_with_them(value: str) -> None:
    """What the message tells the user to copy is read as the value that was meant."""
    with pytest.raises(InvalidInput, match="needs quotes within quotes") as refused:
        check_overrides("run", ["study=ci", f"dataset.recording={value}"])
    copied = shlex.split(str(refused.value).split("quotes within quotes, as in ")[1])[0]
    (read,) = OverridesParser.create().parse_overrides([copied])
    assert (read.key_or_group, read.value()) == ("dataset.recording", value)


def test_every_option_of_every_group_has_a_sentence() -> None:
    for group in GROUPS:
        assert options(group)
        for name in options(group):
            assert sentence(group, name).endswith("."), (group, name)
