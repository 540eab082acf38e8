"""Rankings: bad files are refused by row, a known preference is found, no preference is not, nothing is made up."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from pypdf import PdfReader
from scipy.stats import friedmanchisquare
from scipy.stats import wilcoxon as scipy_wilcoxon

from reports.questionnaire import Key
from reports.rankings import Rankings, read_rankings
from reports.rankings_sheet import build_rankings_sheet
from reports.rankings_statistics import analyse, supported
from retarget.check import InvalidInput
from tests.reports.raters import METHODS, make_key, rank, write

KEY = make_key()
SMALL = make_key(items=2, counts=(5,), methods=("one", "two", "three"))
CLEAR = (1.5, 1.0, 0.0, -1.0)  # utilities of METHODS: each is preferred to the next


def rows(text: str) -> str:
    """A CSV of questionnaire SMALL: lines of participant, item, ranks of A, B and C."""
    lines = ["participant,item,letter,rank"]
    for line in text.split("/"):
        participant, item, *ranks = line.split()
        lines += [f"{participant},{item},{letter},{r}" for letter, r in zip("ABC", ranks, strict=True) if r != "-"]
    return "\n".join(lines) + "\n"


GOOD = rows("ann 1 1 2 3/ann 2 3 1 2/ben 1 2 1 3/ben 2 1 2 3")


def read(tmp_path: Path, text: str | bytes, key: Key = SMALL, **options: str) -> Rankings:
    path = tmp_path / "returned.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_rankings([path], key, **options)


def simulated(seed: int, utilities: tuple[float, ...], people: int = 20, key: Key = KEY, **spread: float) -> Rankings:
    """Rankings of synthetic raters, without the way through a file."""
    given = rank(key, utilities, people, seed, **spread)
    items = {item.number: item for item in key.items}
    table = pd.DataFrame(
        [
            (p, number, items[number].n_examples, items[number].letters[letter], float(r))
            for (p, number, letter), r in given.items()
        ],
        columns=["participant", "item", "n_examples", "method", "rank"],
    )
    return Rankings(key, table, (), "synthetic")


def test_letters_become_methods_by_the_key(tmp_path: Path) -> None:
    found = read(tmp_path, GOOD).ranks
    first = SMALL.items[0]
    ann = found[(found["participant"] == "ann") & (found["item"] == 1)].set_index("method")["rank"]
    assert ann.to_dict() == {first.letters["A"]: 1, first.letters["B"]: 2, first.letters["C"]: 3}
    assert len(found) == 12


@pytest.mark.parametrize(
    "text",
    [
        GOOD.replace("\n", "\r\n"),
        "\ufeff" + GOOD,
        GOOD + "\n\n,,,\n",
        GOOD.replace("participant,item,letter,rank", " Participant ,ITEM,Letter,rank"),
        GOOD.replace(",A,", ",a,").replace(",1\n", ",1.0\n"),
        GOOD.encode("utf-16"),
        "\n".join(f'"{line.split(",")[0]}",{line.split(",", 1)[1]},"a note, quoted"' for line in GOOD.splitlines()),
    ],
    ids=["CRLF", "BOM", "empty rows", "heads", "letters", "UTF-16", "quoted"],
)
def test_what_spreadsheets_write_is_read_alike(tmp_path: Path, text: str | bytes) -> None:
    pd.testing.assert_frame_equal(read(tmp_path, text).ranks, read(tmp_path, GOOD).ranks)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "the file is empty"),
        ("participant,item,letter,rank\n", "no row below the first"),
        (GOOD.replace(",", ";"), "row 1: the columns .* delimiter='\";\"'"),
        (GOOD.replace(",", "\t"), "row 1: the columns .* delimiter"),
        (GOOD.replace("rank", "place", 1), "columns rank are missing. Found: participant, item, letter, place"),
        (GOOD.replace("participant,item", "item,item", 1), "row 1: the columns participant are missing"),
        ("rank," + GOOD.replace("\n", "\n1,").rstrip("1,"), "row 1: the columns rank are there more than once"),
        (GOOD.replace("ann,1,A,1", "ann,1,A"), "row 2: expected 4 values"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,1,9"), "row 2: expected 4 values .* got 5"),
        (GOOD.replace("ann,1,A,1", "ann,7,A,1"), "row 2: '7' is no item of this questionnaire, expected 1 to 2"),
        (GOOD.replace("ann,1,A,1", "ann,,A,1"), "row 2: '' is no item"),
        (GOOD.replace("ben,2,C,3", "ben,2,D,3"), "row 13: item 2 has no picture 'D', expected one of A, B, C"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,first"), "row 2: 'first' is no rank"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,0"), "row 2: '0' is no rank, expected a whole number from 1 .* to 3"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,4"), "row 2: '4' is no rank"),
        (GOOD.replace("ann,1,A,1", 'ann,1,A,"1,5"'), "row 2: '1,5' is no rank"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,-1"), "row 2: '-1' is no rank"),
        (GOOD.replace("ann,1,A,1", "ann,1,A,²"), "row 2: '²' is no rank"),
        (GOOD.replace("ann,1,A,1", " ,1,A,1"), "row 2: expected a participant code"),
        (GOOD.replace("ann,1,A,1", f"{'x' * 65},1,A,1"), "row 2: expected a participant code"),
        (GOOD.replace("ann,1,A,1", "a\x1bnn,1,A,1"), "row 2: expected a participant code"),
        (GOOD.replace("ann,1,B,2", "ann,1,B,1"), "row 3: participant 'ann' gave rank 1 to the pictures A and B"),
        (GOOD + "ann,1,A,1\n", "row 14: participant 'ann' ranked picture A of item 1 before, in returned.csv, row 2"),
        (GOOD.replace("ben", "Ann"), "row 8: participant 'Ann' is also written 'ann' .returned.csv, row 2."),
        (GOOD.replace("ann,1,B,2\n", ""), "1 of 4 items are incomplete; without a rank: participant 'ann', item 1: B"),
        (GOOD.replace("ann,1,B,2", "ann,1,B,"), "participant 'ann', item 1: B"),
        (rows("ann 1 1 2 3/ann 2 1 2 3/ben 1 1 2 3"), "participant 'ben', item 2: A, B, C"),
        (GOOD.replace("ann,1,A,1", 'ann,1,A,"1'), "row .*: this is no CSV"),
        (GOOD.replace("ann", "\xe4nn").encode("latin-1"), "row 2: the text is neither UTF-8 nor UTF-16"),
    ],
)  # fmt: skip
def test_a_file_that_is_no_ranking_is_refused_by_its_row(tmp_path: Path, text: str | bytes, said: str) -> None:
    with pytest.raises(InvalidInput, match=said):
        read(tmp_path, text)


def test_without_rankings_nothing_is_reported(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="Nothing is reported without"):
        read_rankings([tmp_path / "none.csv"], SMALL)
    with pytest.raises(InvalidInput, match="holds no CSV file"):
        read_rankings([tmp_path], SMALL)
    with pytest.raises(InvalidInput, match="got none"):
        read_rankings([], SMALL)
    with pytest.raises(InvalidInput, match="nobody ranked an item completely"):
        read(tmp_path, rows("ann 1 1 - -"), incomplete="drop")


def test_a_semicolon_is_read_when_it_is_named(tmp_path: Path) -> None:
    pd.testing.assert_frame_equal(
        read(tmp_path, GOOD.replace(",", ";"), delimiter=";").ranks, read(tmp_path, GOOD).ranks
    )


def test_ties_share_the_mean_of_their_ranks_where_they_are_allowed(tmp_path: Path) -> None:
    text = rows("ann 1 1 1 3/ann 2 1 1 1")
    found = read(tmp_path, text, ties="average")
    assert found.ranks["rank"].tolist() == [1.5, 1.5, 3.0, 2.0, 2.0, 2.0]
    assert found.tied == 2
    assert read(tmp_path, rows("ann 1 1 1 2/ann 2 1 2 3"), ties="average").ranks["rank"].tolist()[:3] == [1.5, 1.5, 3]


def test_incomplete_items_are_left_out_and_counted_where_that_is_allowed(tmp_path: Path) -> None:
    found = read(tmp_path, rows("ann 1 1 2 3/ann 2 1 - 3/ben 1 1 2 3/ben 2 3 2 1/cay 1 1 - -"), incomplete="drop")
    assert (found.dropped, found.absent, found.participants) == (3, 1, ("ann", "ben"))
    assert len(found.ranks) == 9


def test_rankings_of_another_questionnaire_are_refused(tmp_path: Path) -> None:
    with_id = "\n".join(f"{'questionnaire' if i == 0 else SMALL.id},{line}" for i, line in enumerate(GOOD.splitlines()))
    assert len(read(tmp_path, with_id).ranks) == 12
    with pytest.raises(InvalidInput, match=r"row 2: this is a ranking of questionnaire"):
        read(tmp_path, with_id.replace(SMALL.id, "0123456789ab", 1))


def test_files_of_several_raters_are_read_together(tmp_path: Path) -> None:
    (tmp_path / "ann.csv").write_text(rows("ann 1 1 2 3/ann 2 3 1 2"))
    (tmp_path / "ben.csv").write_text(rows("ben 1 2 1 3/ben 2 1 2 3"))
    found = read_rankings([tmp_path], SMALL)
    pd.testing.assert_frame_equal(found.ranks, read(tmp_path, GOOD).ranks)
    assert [file.name for file in found.files] == ["ann.csv", "ben.csv"]
    (tmp_path / "returned.csv").unlink()
    (tmp_path / "ben.csv").write_text(rows("ann 1 2 1 3/ann 2 1 2 3"))
    with pytest.raises(InvalidInput, match=r"ben.csv, row 2: participant 'ann' .* in ann.csv, row 2"):
        read_rankings([tmp_path], SMALL)


def test_people_and_synthetic_raters_are_never_mixed(tmp_path: Path) -> None:
    text = GOOD.replace("rank\n", "rank,raters\n", 1).replace("\nben", ",synthetic\nben")
    marked = "\n".join(
        line + ("" if i == 0 else ",synthetic" if line.startswith("ben") else ",human")
        for i, line in enumerate(GOOD.replace("rank\n", "rank,raters\n", 1).splitlines())
    )
    assert text != marked
    with pytest.raises(InvalidInput, match=r"human \(returned.csv, row 2\), synthetic \(returned.csv, row 8\)"):
        read(tmp_path, marked)
    with pytest.raises(InvalidInput, match="row 2, raters: 'robot' is unknown"):
        read(tmp_path, marked.replace("human", "robot", 1))


def test_a_known_preference_is_recovered() -> None:
    parts = analyse(simulated(1, CLEAR, taste=0.3, look=0.3))
    assert [part.n_examples for part in parts] == [None, 5, 15, 30]
    combined = parts[0]
    assert sorted(combined.ranks, key=lambda r: r.mean) == list(combined.ranks)
    assert sum(r.mean for r in combined.ranks) == pytest.approx(10)
    assert sum(r.first for r in combined.ranks) == pytest.approx(1)
    assert all(supported(test) and test.difference > 0 and test.effect > 0.8 for test in combined.tests[1:])
    assert combined.friedman < 1e-4
    assert [r.by_error for r in combined.ranks] == [1, 2, 3, 4]
    assert all(np.isnan(test.p_items) for part in parts[1:] for test in part.tests)  # 5 items cannot reach 5 %


def test_a_reference_that_is_disliked_is_found_behind() -> None:
    tests = analyse(simulated(2, CLEAR[::-1]))[0].tests
    assert all(test.difference < 0 and test.effect < 0 and test.wins < 0.5 for test in tests)
    assert supported(tests[-1])


def test_the_statistics_are_those_of_a_second_implementation() -> None:
    rankings = simulated(3, (0.2, 0.1, 0.0, 0.0), people=15, taste=0.5)
    cube = np.zeros((15, 15, 4))
    for p, i, m, r in rankings.ranks[["participant", "item", "method", "rank"]].itertuples(index=False):
        cube[int(p[1:]), i - 1, METHODS.index(m)] = r
    people = cube.mean(axis=1)
    part = analyse(rankings)[0]
    for k, rank_of in enumerate(part.ranks):
        assert rank_of.mean == pytest.approx(cube[:, :, k].mean())
        assert rank_of.spread == pytest.approx(cube[:, :, k].std(ddof=1))
        assert rank_of.low == pytest.approx(people[:, k].mean() - 2.1447867 * people[:, k].std(ddof=1) / 15**0.5)
    p = [scipy_wilcoxon(np.round(people[:, k] - people[:, 0], 9)).pvalue for k in (1, 2, 3)]
    assert [test.p for test in part.tests] == pytest.approx(p)
    smallest = np.argmin(p)
    assert part.tests[smallest].p_holm == pytest.approx(min(1.0, 3 * p[smallest]))
    items = cube.mean(axis=0)
    assert part.tests[0].p_items == pytest.approx(scipy_wilcoxon(np.round(items[:, 1] - items[:, 0], 9)).pvalue)
    flat = cube.reshape(-1, 4)
    assert part.tests[0].p_pooled == pytest.approx(scipy_wilcoxon(flat[:, 1] - flat[:, 0]).pvalue)
    assert part.friedman == pytest.approx(friedmanchisquare(*np.round(people, 9).T).pvalue)


def test_two_raters_by_hand(tmp_path: Path) -> None:
    rankings = read(tmp_path, rows("ann 1 1 2 3/ann 2 1 2 3/ben 1 1 2 3/ben 2 1 2 3"))
    [part] = analyse(rankings)
    letters = [{m: " ABC".index(letter) for letter, m in item.letters.items()} for item in SMALL.items]
    for shown in part.ranks:
        assert shown.mean == pytest.approx(np.mean([ranks[shown.method] for ranks in letters]))
        assert shown.low == shown.high == shown.mean  # both people agree
    assert all(np.isnan([test.p, test.p_holm, test.p_items]).all() for test in part.tests)  # two people prove nothing


def _false_alarms(studies: int, **spread: float) -> tuple[float, float, float, float]:
    """Shares of studies without a preference in which p, p_items and p_pooled are below 5 %, and one is supported.

    14 people and 14 items: scipy takes the normal approximation there.
    """
    key = make_key(items=14, counts=(5,), methods=("one", "two"))
    tests = [analyse(simulated(seed, (0.0, 0.0), people=14, key=key, **spread))[0].tests[0] for seed in range(studies)]
    alarms = np.array([[t.p < 0.05, t.p_items < 0.05, t.p_pooled < 0.05, supported(t)] for t in tests])
    p, p_items, p_pooled, claimed = alarms.mean(axis=0).tolist()
    return p, p_items, p_pooled, claimed


def test_raters_without_preference_are_rarely_called_significant() -> None:
    """At most 5 % by participants, though people have tastes of their own; the pooled test is fooled by them."""
    p, _, p_pooled, claimed = _false_alarms(60, taste=1.0)
    assert p <= 0.12  # 5 % and the binomial margin of 60 studies (99 %)
    assert p_pooled > 0.3
    assert claimed <= 0.12


def test_the_test_on_items_sees_what_single_pictures_show() -> None:
    """Without preference, but with pictures that flatter a method, people agree; other pictures would not."""
    p, p_items, _, claimed = _false_alarms(60, look=1.0)
    assert p > 0.3
    assert p_items <= 0.12
    assert claimed <= 0.12


def _text(path: Path) -> str:
    return " ".join(" ".join(page.extract_text() for page in PdfReader(io.BytesIO(path.read_bytes())).pages).split())


def test_the_report_says_who_ranked_and_from_which_file(tmp_path: Path) -> None:
    path = write(tmp_path / "made_up.csv", rank(KEY, CLEAR, 14, seed=5))
    rankings = read_rankings([path], KEY)
    pdf, summary, people = build_rankings_sheet(rankings, tmp_path / "synthetic")
    text = _text(pdf)
    for words in ("Rankings by 14 synthetic raters, a test", "no person gave these rankings", "made_up.csv", KEY.id,
                  rankings.files[0].sha256[:20], "5 / 15 / 30", "p pooled", "not testable"):  # fmt: skip
        assert words in text, words
    assert "human" not in text
    assert pdf.name == "synthetic_rankings.pdf"
    table = pd.read_csv(summary)
    assert len(table) == 4 * len(METHODS)
    assert set(table["raters"]) == {"synthetic"}
    assert len(pd.read_csv(people)) == 14
    human = build_rankings_sheet(replace(rankings, raters="human", tied=1, dropped=2, absent=1), tmp_path / "human")[0]
    text = _text(human)
    assert "Rankings by 14 human raters" in text
    for words in ("synthetic", "no person"):
        assert words not in text
    assert "1 ranking with ties" in text
    assert "2 incomplete rankings" in text


def test_a_code_that_a_spreadsheet_would_compute_is_quoted(tmp_path: Path) -> None:
    text = GOOD.replace("ann", "=HYPERLINK(0)").replace("ben", "@sum")
    people = build_rankings_sheet(read(tmp_path, text), tmp_path)[2]
    assert set(pd.read_csv(people)["participant"]) == {"'=HYPERLINK(0)", "'@sum"}
