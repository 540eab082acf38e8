"""What decides a result besides its settings: the code, the libraries and the machine."""

from __future__ import annotations

import hashlib
import os
import platform
from functools import cache
from importlib.metadata import version
from pathlib import Path

import baselines
import experiments
import retarget
import synth_data

LIBRARIES = ("numpy", "scipy", "cholespy", "pymetis", "trimesh", "pandas", "pyarrow", "hydra-core")
_EXPERIMENTS_THAT_DECIDE = (
    "protocol.py", "evaluate.py", "references.py", "correspondence.py", "lip_depth.py", "animation.py", "temporal.py",
    "metrics",
)  # fmt: skip


@cache
def code_hash() -> str:
    """SHA-256 over every source file that can change a number: the methods, the data, the protocol, the metrics."""
    root = Path(experiments.__path__[0])
    files = [file for package in (retarget, baselines, synth_data) for file in _sources(Path(package.__path__[0]))]
    files += [file for part in _EXPERIMENTS_THAT_DECIDE for file in _sources(root / part)]
    result = hashlib.sha256()
    for file in sorted(files):
        result.update(file.relative_to(root.parent).as_posix().encode())
        result.update(file.read_bytes())
    return result.hexdigest()


def _sources(path: Path) -> list[Path]:
    return [path] if path.is_file() else list(path.rglob("*.py"))


def environment() -> dict[str, object]:
    """Versions and machine, for the provenance of a report."""
    return {
        "project_version": version("anacondar"),
        "code_hash": code_hash(),
        "python": platform.python_version(),
        "platform": f"{platform.system()} {platform.machine()}",
        "cores": os.cpu_count(),
        "packages": {name: version(name) for name in LIBRARIES},
    }
