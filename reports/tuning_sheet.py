"""A page about a study of the kind `tuning`."""

from __future__ import annotations

from pathlib import Path


def build_tuning_sheet(folder: Path) -> Path:
    raise NotImplementedError
