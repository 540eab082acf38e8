"""Rankings that raters returned, read from CSV files and checked against the key of their questionnaire.

Columns, in any order: participant, item, letter, rank; also `questionnaire` (its id) and `raters` (human, synthetic or
metric; without the column they are human). Others are ignored.
"""

from __future__ import annotations

import csv
import hashlib
import io
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from scipy.stats import rankdata

from reports.questionnaire import Item, Key
from retarget.check import InvalidInput
from retarget.suggest import choose, nearest

COLUMNS = ("participant", "item", "letter", "rank")
RATERS = {"human": "human raters", "synthetic": "synthetic raters", "metric": "metrics"}  # who ranked
TIES = ("refuse", "average")
INCOMPLETE = ("refuse", "drop")
_SHOWN = 5  # cases that a message lists
_LONGEST = 64  # characters of a participant code


@dataclass(frozen=True)
class File:
    """A CSV that was read."""

    name: str
    sha256: str


@dataclass(frozen=True)
class Rankings:
    """Ranks of every method on every item that a participant ranked completely.

    ranks has columns participant, item, n_examples, method, rank (1 is best; a tie has the mean of its ranks).
    """

    key: Key
    ranks: pd.DataFrame
    files: tuple[File, ...]
    raters: str  # a key of RATERS
    tied: int = 0  # items of a participant with a tie
    dropped: int = 0  # items of a participant that were left out because they are incomplete
    absent: int = 0  # participants without a complete item

    @property
    def participants(self) -> tuple[str, ...]:
        return tuple(sorted(self.ranks["participant"].unique()))


@dataclass(frozen=True)
class _Line:
    """One line of a file: the rank of one picture by one participant."""

    where: str
    participant: str
    item: Item
    letter: str
    rank: int | None


def read_rankings(
    paths: Sequence[Path], key: Key, delimiter: str = ",", ties: str = "refuse", incomplete: str = "refuse"
) -> Rankings:
    """Read CSV files, or all of a folder's. ties: refuse | average. incomplete: refuse | drop.

    Raises InvalidInput that names file, row and mend for anything that is no ranking of this questionnaire, and where
    nobody ranked anything: nothing is ever filled in.
    """
    choose("ties", ties, TIES)
    choose("incomplete", incomplete, INCOMPLETE)
    if len(delimiter) != 1 or delimiter in '"\r\n':
        raise InvalidInput(f"delimiter: expected one character, got {delimiter!r}.")
    lines: list[_Line] = []
    files: list[File] = []
    kinds: dict[str, str] = {}  # who ranked -> where it is said first
    for path in _files(paths):
        content = _bytes(path)
        mine = list(_lines(path.name, content, key, delimiter, kinds))
        files.append(File(path.name, hashlib.sha256(content).hexdigest()))
        lines += mine
    if len(kinds) > 1:
        said = ", ".join(f"{kind} ({where})" for kind, where in kinds.items())
        raise InvalidInput(f"rankings: one kind of raters is expected in an analysis, got {said}. Analyse each alone.")
    _check_twice(lines)
    _check_alike(lines)
    return _ranked(lines, key, tuple(files), next(iter(kinds)), ties, incomplete)


def _files(paths: Sequence[Path]) -> list[Path]:
    found: list[Path] = []
    for path in paths:
        inside = sorted(path.glob("*.csv")) if path.is_dir() else [path]
        if not inside:
            raise InvalidInput(f"{path}: this folder holds no CSV file; expected one from each rater, or all in one.")
        found += inside
    if not found:
        raise InvalidInput("rankings: expected at least one CSV file, got none. Nothing is reported without rankings.")
    return found


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise InvalidInput(
            f"{path}: cannot be read ({error.strerror or error}). Name the CSV with the rankings that raters returned: "
            "rankings=FILE. Nothing is reported without."
        ) from error


def _lines(name: str, content: bytes, key: Key, delimiter: str, kinds: dict[str, str]) -> Iterator[_Line]:
    """Every line of one file; notes in `kinds` who ranked."""
    rows = _rows(name, content, delimiter)
    heads = [head.strip().lower() for head in next(rows, (0, [""]))[1]]
    if not any(heads):
        raise InvalidInput(f"{name}: the file is empty, expected the columns {', '.join(COLUMNS)} and a row for each "
                           "rank that a participant gave.")  # fmt: skip
    if missing := [column for column in COLUMNS if column not in heads]:
        other = next((mark for mark in ";\t,|" if mark != delimiter and len(delimiter.join(heads).split(mark)) > 3), "")
        mend = (
            f"It looks as if columns were separated by {other!r}, as some spreadsheets do: delimiter='\"{other}\"'."
            if other
            else f"Found: {', '.join(filter(None, heads))}. The first row names the columns."
        )
        raise InvalidInput(f"{name}, row 1: the columns {', '.join(missing)} are missing. {mend}")
    if twice := sorted({head for head in heads if head and heads.count(head) > 1}):
        raise InvalidInput(f"{name}, row 1: the columns {', '.join(twice)} are there more than once; keep one of each.")
    empty = True
    for number, values in rows:
        where = f"{name}, row {number}"
        if len(values) != len(heads):
            raise InvalidInput(
                f"{where}: expected {len(heads)} values as in the first row, got {len(values)}. Quote a value that "
                "holds the delimiter, and fill in what is missing."
            )
        row = dict(zip(heads, (value.strip() for value in values), strict=True))
        empty = False
        kinds.setdefault(choose(f"{where}, raters", row.get("raters") or "human", RATERS), where)
        if row.get("questionnaire", key.id) != key.id:
            raise InvalidInput(
                f"{where}: this is a ranking of questionnaire '{row['questionnaire']}', the key is that of '{key.id}'. "
                "Name the key that was written with it: key=FILE."
            )
        item = _item(where, row["item"], key)
        letter = row["letter"].upper()
        if letter not in item.letters:
            raise InvalidInput(
                f"{where}: item {item.number} has no picture '{row['letter']}', expected one of "
                f"{', '.join(item.letters)}. Correct the letter."
            )
        rank = _rank(where, row["rank"], len(item.letters))
        yield _Line(where, _participant(where, row["participant"]), item, letter, rank)
    if empty:
        raise InvalidInput(f"{name}: there is no row below the first, so nobody ranked anything; leave this file out.")


def _rows(name: str, content: bytes, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """(number, values) of each row that is not empty; a byte order mark and any ends of lines are accepted."""
    encoding = "utf-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    try:
        text = content.decode(encoding)
    except UnicodeDecodeError as error:
        row = content[: error.start].count(b"\n") + 1
        raise InvalidInput(
            f"{name}, row {row}: the text is neither UTF-8 nor UTF-16; save the table as 'CSV UTF-8'."
        ) from error
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    while True:
        try:
            values = next(reader)
        except StopIteration:
            return
        except csv.Error as error:
            raise InvalidInput(
                f"{name}, row {reader.line_num}: this is no CSV ({error}); save the table anew."
            ) from error
        if any(value.strip() for value in values):
            yield reader.line_num, values


def _item(where: str, text: str, key: Key) -> Item:
    by_number = {str(item.number): item for item in key.items}
    wanted = text.removesuffix(".0").lstrip("0")
    if wanted not in by_number:
        raise InvalidInput(
            f"{where}: '{text}' is no item of this questionnaire, expected 1 to {len(by_number)}."
            f"{nearest(wanted, by_number) if wanted else ''} Correct the number, or name the right key with key=FILE."
        )
    return by_number[wanted]


def _rank(where: str, text: str, last: int) -> int | None:
    """None for an empty cell."""
    if not text:
        return None
    whole = text.removesuffix(".0")
    if not (whole.isascii() and whole.isdigit() and 1 <= int(whole) <= last):
        raise InvalidInput(f"{where}: '{text[:20]}' is no rank, expected a whole number from 1 (best) to {last}.")
    return int(whole)


def _participant(where: str, text: str) -> str:
    if not text or len(text) > _LONGEST or not text.isprintable():
        raise InvalidInput(
            f"{where}: expected a participant code of 1 to {_LONGEST} printable characters, got {text[:_LONGEST]!r}. "
            "Give every participant a code of their own."
        )
    return text


def _check_twice(lines: Sequence[_Line]) -> None:
    """Raises InvalidInput where a participant ranked a picture twice."""
    first: dict[tuple[str, int, str], str] = {}
    for line in lines:
        at = (line.participant, line.item.number, line.letter)
        if at in first:
            raise InvalidInput(
                f"{line.where}: participant '{line.participant}' ranked picture {line.letter} of item "
                f"{line.item.number} before, in {first[at]}. If two people share a code, give them different ones; "
                "if a file was returned twice, keep one."
            )
        first[at] = line.where


def _check_alike(lines: Sequence[_Line]) -> None:
    """Raises InvalidInput for codes that differ by case alone: one person may have two of them."""
    seen: dict[str, _Line] = {}
    for line in lines:
        other = seen.setdefault(line.participant.casefold(), line)
        if other.participant != line.participant:
            raise InvalidInput(
                f"{line.where}: participant '{line.participant}' is also written '{other.participant}' "
                f"({other.where}). Write the code of one person alike, or give two people different ones."
            )


def _ranked(
    lines: Sequence[_Line], key: Key, files: tuple[File, ...], raters: str, ties: str, incomplete: str
) -> Rankings:
    answers: dict[tuple[str, int], dict[str, _Line]] = {}
    for line in lines:
        answers.setdefault((line.participant, line.item.number), {})[line.letter] = line
    participants = sorted({line.participant for line in lines})
    rows, lacking, tied = [], [], 0
    for participant in participants:
        for item in key.items:
            given = answers.get((participant, item.number), {})
            gave = {letter: line.rank for letter, line in given.items() if line.rank is not None}
            if len(gave) < len(item.letters):
                missing = [letter for letter in item.letters if letter not in gave]
                lacking.append(f"participant '{participant}', item {item.number}: {', '.join(missing)}")
                continue
            tied += _has_ties(participant, item, given, ties)
            order = rankdata([gave[letter] for letter in item.letters])
            rows += [
                (participant, item.number, item.n_examples, method, float(rank))
                for method, rank in zip(item.letters.values(), order, strict=True)
            ]
    if lacking and incomplete == "refuse":
        more = f", and {len(lacking) - _SHOWN} more" if len(lacking) > _SHOWN else ""
        raise InvalidInput(
            f"rankings: {len(lacking)} of {len(participants) * len(key.items)} items are incomplete; without a rank: "
            f"{'; '.join(lacking[:_SHOWN])}{more}. Complete them, or leave these items of these participants out with "
            "incomplete=drop; the report says how many."
        )
    ranks = pd.DataFrame(rows, columns=["participant", "item", "n_examples", "method", "rank"])
    if ranks.empty:
        raise InvalidInput("rankings: nobody ranked an item completely, so there is nothing to report.")
    absent = len(participants) - ranks["participant"].nunique()
    return Rankings(key, ranks, files, raters, tied, len(lacking), absent)


def _has_ties(participant: str, item: Item, given: dict[str, _Line], ties: str) -> bool:
    """Raises InvalidInput for ties that are not wanted, and for ranks that no order of the pictures gives."""
    ranks = sorted(int(line.rank) for line in given.values() if line.rank is not None)
    if len(set(ranks)) == len(ranks):
        return False
    if ties == "refuse":
        rank = next(r for r in ranks if ranks.count(r) > 1)
        same = [line for line in given.values() if line.rank == rank]
        raise InvalidInput(
            f"{same[-1].where}: participant '{participant}' gave rank {rank} to the pictures "
            f"{' and '.join(line.letter for line in same)} of item {item.number}. Correct it, or let ties share the "
            "mean of their ranks with ties=average."
        )
    return True
