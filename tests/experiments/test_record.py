import errno
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from experiments import record
from experiments.record import Record, digest, read_header, read_record, write_record
from retarget.check import InvalidInput
from retarget.io.files import write_whole

ROWS = pa.table({"value": [1.5, float("nan")], "region": ["head", "lips"]})
HEADER = {"schema": record.SCHEMA, "cell": "abc", "status": "ok", "solves": [{"energy": [2.0, 1.0]}]}


def test_a_record_comes_back_as_it_went(tmp_path: Path) -> None:
    assert read_record(tmp_path) is None
    assert read_header(tmp_path) is None
    write_record(tmp_path / "cell", Record(HEADER, ROWS))
    back = read_record(tmp_path / "cell")
    assert back is not None
    pd.testing.assert_frame_equal(back.rows.to_pandas(), ROWS.to_pandas())
    assert back.header == HEADER == read_header(tmp_path / "cell")


def test_an_old_schema_is_refused_and_kept(tmp_path: Path) -> None:
    write_record(tmp_path, Record({**HEADER, "schema": 0}, ROWS))
    before = (tmp_path / record.RECORD).read_bytes()
    for read in (read_record, read_header):
        with pytest.raises(InvalidInput, match=r"schema 0, this version reads and writes schema 1"):
            read(tmp_path)
    assert (tmp_path / record.RECORD).read_bytes() == before


def test_a_file_that_is_no_record_is_refused(tmp_path: Path) -> None:
    (tmp_path / record.RECORD).write_bytes(b"PAR1 half a file")
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_header(tmp_path)
    pq.write_table(pa.table({"x": [1]}), tmp_path / record.RECORD)
    with pytest.raises(InvalidInput, match="cannot be read"):
        read_record(tmp_path)


@pytest.mark.parametrize(
    ("code", "words"),
    [(errno.ENOSPC, "the disk is full"), (errno.EACCES, "cannot be written"), (errno.EROFS, "cannot be")],
)
def test_a_write_that_fails_leaves_the_old_file_and_no_half_one(tmp_path: Path, code: int, words: str) -> None:
    path = tmp_path / "table.csv"
    path.write_text("old")

    def fill_the_disk(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(code, "no")

    with pytest.raises(InvalidInput, match=words):
        write_whole(path, fill_the_disk)
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]
    assert path.read_text() == "old"


def test_a_folder_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "results").write_text("a file")
    with pytest.raises(InvalidInput, match=r"paths\.results"):
        write_whole(tmp_path / "results" / "x.csv", lambda temporary: temporary.write_text("new"))


def test_digest_ignores_the_order_of_keys_and_nothing_else() -> None:
    assert digest({"a": 1, "b": [1, 2]}) == digest({"b": [1, 2], "a": 1})
    assert digest({"a": 1}) != digest({"a": 1.5})
    assert digest({"a": [1, 2]}) != digest({"a": [2, 1]})
