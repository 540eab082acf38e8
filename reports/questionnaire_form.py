"""A questionnaire as raters see it: a page for a browser, without a network, and the same items on paper.

Neither names a method, an identity, an expression or an error: all pictures are made alike, in skin colour, by one
camera, and the letters are all that tells them apart.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import matplotlib
import numpy as np
import typst
from joblib import Parallel, delayed

from reports.camera import Camera, look
from reports.html_head import HEAD
from reports.questionnaire import EXAMPLES, Mesh, Questionnaire, Shown
from reports.render import render_mesh, write_image
from retarget.io.files import write_whole
from retarget.types import IntArray

SIZE = (440, 560)  # pixels of one head
COLUMNS = ("questionnaire", "participant", "item", "letter", "rank")  # of the file that the form hands out
SOURCE = "Source"
_PAGE, _PAPER = (Path(__file__).with_name(f"questionnaire.{suffix}") for suffix in ("html", "typ"))
_STILL = 0.35  # of the largest motion: a vertex that moves less does not decide how low the pictures reach


@dataclass(frozen=True)
class Sheet:
    """One item as it is printed: file names of its pictures. example is None where none is shown."""

    number: int
    source: str
    example: str | None
    caption: str
    results: Mapping[str, str]  # letter -> file


def write_form(
    made: Questionnaire,
    folder: Path,
    size: tuple[int, int] = SIZE,
    progress: Callable[[str], None] = lambda line: None,
) -> tuple[Path, Path]:
    """Write questionnaire.html and questionnaire.pdf into a folder, each whole or not at all; returns both paths."""
    page, paper = folder / "questionnaire.html", folder / "questionnaire.pdf"
    with tempfile.TemporaryDirectory(prefix="questionnaire-") as name:
        work = Path(name)
        sheets = _pictures(made, work, size, progress)
        text = _html(made, sheets, work)
        progress("typesetting")
        pdf = _pdf(made, sheets, work)
    write_whole(page, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    write_whole(paper, lambda temporary: temporary.write_bytes(pdf))
    return page, paper


def _pictures(made: Questionnaire, work: Path, size: tuple[int, int], progress: Callable[[str], None]) -> list[Sheet]:
    camera = _camera(made.shown, size)
    orders: list[tuple[Path, Mesh, IntArray, Camera, tuple[int, int]]] = []

    def order(name: str, vertices: Mesh, faces: IntArray) -> str:
        file = f"{name}.jpg"
        orders.append((work / file, vertices, faces, camera, size))
        return file

    sheets = []
    for shown in made.shown:
        number, faces = shown.item.number, shown.frames.faces
        sheets.append(
            Sheet(
                number=number,
                source=order(f"{number}-source", shown.source, faces),
                example=None if shown.example is None else order(f"{number}-target", shown.example, faces),
                caption=EXAMPLES[shown.item.example.kind],
                results={letter: order(f"{number}-{letter}", v, faces) for letter, v in shown.results.items()},
            )
        )
    progress(f"rendering {len(orders)} heads")
    Parallel(n_jobs=min(os.cpu_count() or 1, 8, max(len(orders) // 8, 1)))(delayed(_take)(*one) for one in orders)
    return sheets


def _take(path: Path, vertices: Mesh, faces: IntArray, camera: Camera, size: tuple[int, int]) -> None:
    write_image(path, render_mesh(vertices, faces, camera, size))


def _camera(shown: Sequence[Shown], size: tuple[int, int]) -> Camera:
    """One view for all pictures, which holds every performance down to the lowest vertex that moves.

    Results do not move it: one that went astray would make all others small.
    """
    points, floor = [], np.inf
    for s in shown:
        truth = s.frames.truth
        motion = np.linalg.norm(truth - s.frames.target_neutral, axis=2).max(axis=0)
        moving = np.flatnonzero(motion > _STILL * float(motion.max(initial=0.0)))
        for head in (s.source, *truth, s.frames.source_neutral, s.frames.target_neutral):
            points.append(np.asarray(head, dtype=np.float64))
            if len(moving):
                floor = min(floor, float(head[moving, 1].min()))
    everything = np.concatenate(points)
    above = everything[everything[:, 1] >= floor - 4.0] if np.isfinite(floor) else everything
    return look(above, size, turn=24.0, raise_=3.0, margin=0.03)


def _html(made: Questionnaire, sheets: Sequence[Sheet], work: Path) -> str:
    def picture(file: str, alt: str) -> str:
        data = base64.b64encode((work / file).read_bytes()).decode()
        return f'<img src="data:image/jpeg;base64,{data}" alt="{escape(alt)}">'

    items = []
    for s in sheets:
        shown = [f"<figure>{picture(s.source, SOURCE)}<figcaption>{SOURCE}</figcaption></figure>"]
        if s.example is not None:
            shown.append(
                f"<figure>{picture(s.example, s.caption)}<figcaption>{escape(s.caption)}</figcaption></figure>"
            )
        choices = "".join(
            f'<figure>{picture(file, letter)}<figcaption class="letter">{letter}</figcaption>'
            f"{_ranks(s.number, letter, len(s.results))}</figure>"
            for letter, file in s.results.items()
        )
        items.append(
            f'<section data-item="{s.number}"><h2>{s.number} <span>of {len(sheets)}</span></h2>'
            f'<div class="row given">{"".join(shown)}</div><div class="row results">{choices}</div>'
            '<p class="missing">Give every picture a rank.</p></section>'
        )
    facts = {"id": made.key.id, "columns": COLUMNS, "letters": {str(s.number): list(s.results) for s in sheets}}
    return Template(_PAGE.read_text(encoding="utf-8")).substitute(
        head=HEAD,
        question=escape(str(made.key.design["question"])),
        last=len(made.key.methods),
        count=len(sheets),
        items="\n".join(items),
        facts=json.dumps(facts).replace("<", "\\u003c"),
        id=escape(made.key.id),
    )


def _ranks(number: int, letter: str, count: int) -> str:
    """Ranks of one picture as a row of radio buttons."""
    buttons = "".join(
        f'<label><input type="radio" name="{number}-{letter}" value="{rank}" data-letter="{letter}" '
        f'aria-label="item {number}, picture {letter}: rank {rank}"><span>{rank}</span></label>'
        for rank in range(1, count + 1)
    )
    return f'<div class="ranks" role="radiogroup" aria-label="rank of {letter}">{buttons}</div>'


def _pdf(made: Questionnaire, sheets: Sequence[Sheet], work: Path) -> bytes:
    content: dict[str, Any] = {
        "id": made.key.id,
        "question": made.key.design["question"],
        "last": len(made.key.methods),
        "source": SOURCE,
        "items": [
            {
                "number": s.number,
                "source": s.source,
                "example": s.example,
                "caption": s.caption,
                "results": [{"letter": letter, "file": file} for letter, file in s.results.items()],
            }
            for s in sheets
        ],
    }
    (work / "content.json").write_text(json.dumps(content), encoding="utf-8")
    shutil.copy(_PAPER, work / _PAPER.name)
    made_pdf: bytes = typst.compile(
        str(work / _PAPER.name),
        root=str(work),
        format="pdf",
        font_paths=[str(Path(matplotlib.get_data_path()) / "fonts" / "ttf")],
        ignore_system_fonts=True,
        timestamp=0,
    )
    return made_pdf
