"""Which code makes the frames of a dataset: its modules and all of this project that they import, by their text."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from importlib import resources
from pathlib import Path

from synth_data.cache import fingerprint

ROOTS = ("synth_data", "retarget")  # packages of this project that data may depend on
IDLE = ("author_", "measure")  # how the names of programs begin that make no frames
ROOT = Path(str(resources.files("synth_data"))).parent


def code_files(*packages: str) -> tuple[Path, ...]:
    """Files of packages, data in JSON included, and of what their modules import, directly or not; sorted."""
    found: set[Path] = set()
    waiting = [file for package in packages for file in _folder(package).iterdir() if _makes_frames(file)]
    while waiting:
        file = waiting.pop()
        if file not in found:
            found.add(file)
            waiting += _imported(file) if file.suffix == ".py" else []
    return tuple(sorted(found))


@functools.cache
def code_digest(*packages: str) -> str:
    """SHA-256 over `code_files`, names and contents."""
    parts = ((file.relative_to(ROOT).as_posix(), file.read_bytes()) for file in code_files(*packages))
    return fingerprint(part for pair in parts for part in pair)


def _folder(package: str) -> Path:
    return ROOT.joinpath(*package.split("."))


def _makes_frames(file: Path) -> bool:
    return file.suffix in (".py", ".json") and not file.name.startswith(IDLE)


def _imported(file: Path) -> Iterator[Path]:
    """The files of modules that a module imports, wherever in its text, and of the packages they lie in."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        for name in names:
            parts = name.split(".")
            if parts[0] in ROOTS:
                yield from (
                    each
                    for end in range(1, len(parts) + 1)
                    for each in (
                        ROOT.joinpath(*parts[:end], "__init__.py"),
                        ROOT.joinpath(*parts[:end]).with_suffix(".py"),
                    )
                    if each.is_file()
                )
