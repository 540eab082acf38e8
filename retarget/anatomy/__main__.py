"""`python -m retarget.anatomy build MESH REGIONS [--size coarse]`: the head template of a topology, built and kept."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
from rich.console import Console

from retarget.anatomy.store import load_template, store_template
from retarget.anatomy.template import REFINEMENTS
from retarget.check import InvalidInput
from retarget.io.mesh import read_mesh
from retarget.io.regions import read_regions


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m retarget.anatomy", description=__doc__)
    build = parser.add_subparsers(dest="command", required=True).add_parser("build", help="build, keep and describe")
    build.add_argument("mesh", type=Path, help=".obj or .ply in mm: the neutral skin, neck open, lips and lids apart")
    build.add_argument("regions", type=Path, help="regions.json, see docs/regions.md")
    build.add_argument("--size", choices=tuple(REFINEMENTS), default="coarse", help="what to describe (default coarse)")
    build.add_argument("--cache", type=Path, help="folder to keep it in (default: the user's cache folder)")
    options = parser.parse_args(arguments)
    console = Console()
    try:
        vertices, faces = read_mesh(options.mesh)
        regions = read_regions(options.regions, len(vertices), faces)
        with console.status("head template") as status:
            path = store_template(vertices, faces, regions, cache=options.cache, progress=status.update)
        template = load_template(faces, regions, options.size, options.cache)
    except InvalidInput as error:
        console.print(f"[red]{type(error).__name__}[/red]: ", end="")
        console.print(str(error), markup=False, highlight=False, soft_wrap=True)
        return 1
    console.print(str(path), markup=False, highlight=False, soft_wrap=True)
    console.print(
        f"{options.size}: {len(template.vertices)} vertices, {len(template.tets)} tets "
        f"({np.mean(template.muscle):.0%} muscle), skull {len(template.skull)} vertices "
        f"({len(template.cranium)} cranium, {len(template.jaw)} jaw)"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
