"""A page or two of pictures and tables about one study, typeset; the same content gives the same bytes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, cast

import matplotlib
import numpy as np
import typst
from matplotlib.colors import to_hex

from reports.colors import ERROR_COLORMAP
from retarget.io.files import write_whole

_TEMPLATE = Path(__file__).with_name("sheet.typ")


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
    """Write a PDF, or a PNG of the first page, whole or not at all; `work` is the folder with the pictures."""
    content: dict[str, Any] = {
        "title": title,
        "description": " ".join(description.split()),
        "blocks": [asdict(block) for block in blocks],
        "colors": [to_hex(ERROR_COLORMAP(x)) for x in np.linspace(0, 1, 11)],
    }
    (work / "content.json").write_text(json.dumps(content), encoding="utf-8")
    shutil.copy(_TEMPLATE, work / _TEMPLATE.name)
    made: bytes | list[bytes] = cast(Any, typst.compile)(
        str(work / _TEMPLATE.name),
        root=str(work),
        format="png" if path.suffix == ".png" else "pdf",
        ppi=ppi,
        font_paths=[str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")],
        ignore_system_fonts=True,
        timestamp=0,
    )
    page = made[0] if isinstance(made, list) else made
    write_whole(path, lambda temporary: temporary.write_bytes(page))
