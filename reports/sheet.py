"""A page or two of pictures and tables about one study, typeset; the same content gives the same bytes.

Beside a PDF ``NAME.pdf`` stands a folder ``NAME.sheet`` with what is on it, from which a report takes it over.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
import typst
from matplotlib.colors import to_hex

from reports.colors import ERROR_COLORMAP
from retarget.check import InvalidInput
from retarget.io.files import write_whole, write_whole_folder

TEMPLATES = tuple(Path(__file__).with_name(name) for name in ("sheet.typ", "blocks.typ"))
SCHEMA = 1
CONTENT = "content.json"


@dataclass(frozen=True)
class Picture:
    """file: its name in the sheet's folder. limit: upper end of the colour bar below it, as text, in mm."""

    file: str
    caption: str = ""
    limit: str | None = None


@dataclass(frozen=True)
class PictureRow:
    pictures: tuple[Picture, ...]
    title: str = ""  # above the row


@dataclass(frozen=True)
class Pictures:
    """Pictures in rows and columns; widths are relative."""

    heads: tuple[str, ...]
    widths: tuple[float, ...]
    rows: tuple[PictureRow, ...]
    caption: str
    kind: str = "grid"


@dataclass(frozen=True)
class Table:
    """Text in rows and columns, the first to the left, all others to the right."""

    heads: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str
    kind: str = "table"


def write_sheet(
    path: Path, title: str, description: str, blocks: Sequence[Pictures | Table], work: Path, ppi: float = 110.0
) -> None:
    """Write a PDF with its content beside it, or a PNG of the first page; `work` is the folder with the pictures.

    Every file is written whole or not at all.
    """
    content: dict[str, Any] = {
        "schema": SCHEMA,
        "title": title,
        "description": " ".join(description.split()),
        "blocks": [asdict(block) for block in blocks],
        "colors": [to_hex(ERROR_COLORMAP(x)) for x in np.linspace(0, 1, 11)],
    }
    (work / CONTENT).write_text(json.dumps(content), encoding="utf-8")
    for template in TEMPLATES:
        shutil.copy(template, work / template.name)
    made: bytes | list[bytes] = cast(Any, typst.compile)(
        str(work / TEMPLATES[0].name),
        root=str(work),
        format="png" if path.suffix == ".png" else "pdf",
        ppi=ppi,
        font_paths=[str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")],
        ignore_system_fonts=True,
        timestamp=0,
    )
    page = made[0] if isinstance(made, list) else made
    write_whole(path, lambda temporary: temporary.write_bytes(page))
    if path.suffix == ".pdf":
        names = (CONTENT, *pictures(content["blocks"]))
        write_whole_folder(
            path.with_suffix(".sheet"), lambda folder: [shutil.copy(work / name, folder / name) for name in names]
        )


def pictures(blocks: Sequence[Mapping[str, Any]]) -> tuple[str, ...]:
    """The files that blocks show."""
    rows = [row for block in blocks if block["kind"] == "grid" for row in block["rows"]]
    return tuple(dict.fromkeys(str(picture["file"]) for row in rows for picture in row["pictures"]))


def read_sheet(folder: Path) -> dict[str, Any]:
    """The content of a ``NAME.sheet``: title, description, blocks.

    Raises InvalidInput for one that is no sheet, of another schema, or without one of its pictures.
    """
    path = folder / CONTENT
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        schema = content.get("schema") if isinstance(content, dict) else None
    except (OSError, ValueError) as error:
        raise InvalidInput(f"{path}: expected the content of a sheet, {error}. Run the study again.") from error
    if schema != SCHEMA:
        raise InvalidInput(
            f"{path}: this sheet has schema {schema}, this version reads schema {SCHEMA}. Run the study again."
        )
    try:
        files = pictures(content["blocks"])
    except (KeyError, TypeError) as error:
        raise InvalidInput(
            f"{path}: expected blocks of pictures and tables, {error!r}. Run the study again."
        ) from error
    for name in files:
        if Path(name).name != name or not (folder / name).is_file():
            raise InvalidInput(f"{folder / name}: this picture of the sheet is missing; run the study again.")
    return cast(dict[str, Any], content)
