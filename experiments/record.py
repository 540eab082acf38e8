"""One Parquet file per cell: rows of metrics, and a header that says how they came about.

A record is written to a temporary name and moved into place, so that a file which exists is whole. A finished
cell is reused only if its id, the code version and the data fingerprint match.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from retarget.check import InvalidInput
from retarget.io.files import write_whole

SCHEMA = 1
RECORD = "record.parquet"
FRAMES = "frames.npz"
_HEADER = b"experiments.record"


@dataclass(frozen=True)
class Record:
    """What one cell left behind.

    header: schema, cell (id), code, data (fingerprint), status, reason, config, versions, prediction (SHA-256 of
    the retargeted frames), solves (status per frame), correspondence_solves (status per embedded example), directions,
    prepare_seconds, correspondence_seconds, fit_seconds, seconds_per_expression, peak_memory_mb.
    rows: the columns METRIC_COLUMNS, one row per expression, metric and region.
    """

    header: Mapping[str, Any]
    rows: pa.Table


def digest(content: Any) -> str:
    """SHA-256 of plain data, independent of key order."""
    return hashlib.sha256(json.dumps(content, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def write_record(folder: Path, record: Record) -> None:
    """Write folder/record.parquet whole or not at all. Raises InvalidInput if the disk refuses."""
    table = record.rows.replace_schema_metadata({_HEADER: json.dumps(record.header)})
    write_whole(folder / RECORD, lambda temporary: pq.write_table(table, temporary))


def read_record(folder: Path) -> Record | None:
    """The record in a cell's folder, or None where there is none.

    Raises InvalidInput for a file of another schema or one that is not a record.
    """
    path = folder / RECORD
    if not path.exists():
        return None
    with _as_a_record(path):
        table = pq.ParquetFile(path).read()
        header = _header(path, table.schema)
    return Record(header, table.replace_schema_metadata())


def read_header(folder: Path) -> Mapping[str, Any] | None:
    """The header alone: enough to decide whether a cell is finished. Raises like `read_record`."""
    path = folder / RECORD
    if not path.exists():
        return None
    with _as_a_record(path):
        return _header(path, pq.read_schema(path))


@contextmanager
def _as_a_record(path: Path) -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, KeyError, json.JSONDecodeError) as error:
        raise InvalidInput(
            f"{path}: expected a record of this program, got a file that cannot be read as one ({error}). "
            "Move it away; the cell will then be computed again."
        ) from error


def _header(path: Path, schema: pa.Schema) -> Mapping[str, Any]:
    header: Mapping[str, Any] = json.loads((schema.metadata or {})[_HEADER])
    if header.get("schema") != SCHEMA:
        raise InvalidInput(
            f"{path}: this record has schema {header.get('schema')}, this version reads and writes schema {SCHEMA}. "
            "Nothing was overwritten. Move the results folder away, or choose another with paths.results=FOLDER."
        )
    return header
