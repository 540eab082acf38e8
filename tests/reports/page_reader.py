"""The page read back by other means than its own script: the standard library's parser, zlib and numpy."""

from __future__ import annotations

import base64
import json
import zlib
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import numpy as np


class Read(HTMLParser):
    """Tags with their attributes, tables as rows of text, and the text of scripts by id."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.tables: list[list[list[str]]] = []
        self.scripts: dict[str, str] = {}
        self.words = ""
        self._open: list[str] = []
        self._script: str | None = None
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        self._open.append(tag)
        if tag == "script":
            self._script = dict(attrs).get("id") or ""
            self.scripts[self._script] = ""
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass
        if tag == "script":
            self._script = None

    def handle_data(self, data: str) -> None:
        if self._script is not None:
            self.scripts[self._script] += data
        elif "style" not in self._open:
            self.words += data
            if "td" in self._open or "th" in self._open:
                self.tables[-1][-1][-1] += data

    @property
    def heads(self) -> dict[str, Any]:
        facts: dict[str, Any] = json.loads(self.scripts["heads"])
        return facts

    def integers(self, number: int) -> np.ndarray:
        return unpacked(self.scripts[f"array-{number}"])


def unpacked(text: str) -> np.ndarray:
    """(m,) integers of one array of the page."""
    raw = base64.b64decode(text)
    planes = np.frombuffer(zlib.decompress(raw[1:]), dtype=np.uint8).reshape(raw[0], -1).astype(np.int64)
    zigzag = (planes * (256 ** np.arange(raw[0]))[:, None]).sum(axis=0)
    return np.where(zigzag % 2 == 0, zigzag // 2, -(zigzag + 1) // 2)


@dataclass
class Meshes:
    """The arrays of one study as meshes in mm."""

    read: Read
    study: dict[str, Any]
    order: np.ndarray = field(init=False)
    before: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.order, self.before = (np.cumsum(self.read.integers(self.study[name])) for name in ("order", "before"))

    def indices(self, name: str) -> np.ndarray:
        return np.cumsum(self.read.integers(self.study[name]))

    def frames(self, number: int) -> np.ndarray:
        """(t, n, 3) mm."""
        steps = self.read.integers(number).reshape(-1, 3, len(self.order)).transpose(0, 2, 1)
        along = np.zeros_like(steps)
        along[:, 0] = steps[:, 0]
        for i in range(1, len(self.order)):
            along[:, i] = steps[:, i] + along[:, self.before[i]]
        out = np.empty_like(along)
        out[:, self.order] = along
        return out * self.study["step"]
