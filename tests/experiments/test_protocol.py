import pytest

from experiments.protocol import check_counts, draw
from retarget.check import InvalidInput


def test_examples_are_nested_and_never_tested() -> None:
    drawn = draw("a", "b", 0, expressions=250, test_expressions=5, seed=0)
    assert set(drawn.examples(5)) < set(drawn.examples(15)) < set(drawn.examples(30))
    assert not set(drawn.test) & set(drawn.order)
    assert sorted(drawn.test + drawn.order) == list(range(250))


def test_draws_depend_on_the_pair_the_number_and_the_seed_alone() -> None:
    base = draw("a", "b", 0, 250, 5, 0)
    assert base == draw("a", "b", 0, 250, 5, 0)
    others = [draw("b", "a", 0, 250, 5, 0), draw("a", "b", 1, 250, 5, 0), draw("a", "b", 0, 250, 5, 1)]
    assert all(other.order != base.order for other in others)


def test_more_examples_than_expressions_are_refused_with_both_numbers() -> None:
    check_counts(35, 5, [5, 30])
    with pytest.raises(InvalidInput, match=r"30 examples asked for, but the dataset has 34 .* at most 29"):
        check_counts(34, 5, [5, 30])
    with pytest.raises(InvalidInput, match=r"'study\.n_examples=\[5,15\]'"):
        check_counts(20, 5, [5, 15, 30])
    with pytest.raises(InvalidInput, match="Hold out fewer"):
        check_counts(5, 5, [5])
