"""Tetrahedra between surfaces by fTetWild (Hu et al. 2020), in a process of its own.

fTetWild writes files into the working folder and reports on standard output, hence the process; it is run by one
thread. It shuffles its input by the system's random numbers, so a rebuilt mesh is alike, not the same: what must be
the same everywhere is stored (see `store`).
"""

from __future__ import annotations

import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput
from retarget.types import FloatArray, IntArray

Progress = Callable[[str], object]
_PASS = re.compile(r"/ pass (\d+) /")


def tetrahedralise(
    vertices: FloatArray,
    faces: IntArray,
    sizing: tuple[FloatArray, IntArray, FloatArray],
    envelope: float,
    quality: float,
    progress: Progress = lambda line: None,
) -> tuple[FloatArray, IntArray]:
    """Vertices (m, 3) mm and positively oriented tets (t, 4) where the oriented surface winds once.

    `sizing` is a background mesh (points, tets, edge length in mm at the points), `envelope` the distance in mm that
    the boundary may keep from the surface, `quality` the AMIPS energy at which optimisation stops (3 is the regular
    tet). Raises InvalidInput if the mesher fails or leaves nothing.
    """
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "given.npz", Path(folder) / "made.npz"
        points, cells, lengths = sizing
        np.savez(given, v=vertices, f=faces, p=points, c=cells, h=lengths, settings=np.array([envelope, quality]))
        last = ""
        with subprocess.Popen(
            [sys.executable, "-m", __name__, given.name, made.name],
            cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    if found := _PASS.search(line):
                        progress(f"tetrahedra: pass {found[1]}")
                    last = line.strip() or last
            except BaseException:  # interrupted: no mesher goes on unseen
                process.kill()
                raise
        if process.returncode != 0 or not made.is_file():
            raise InvalidInput(
                f"tetrahedra: fTetWild ended with status {process.returncode} and {last!r}; check that the surface is "
                "closed, free of self-intersections and in mm."
            )
        with np.load(made) as result:
            x, tets = result["x"], result["t"].astype(np.int64)
    if len(tets) == 0:
        raise InvalidInput("tetrahedra: expected some between skin and skull, got none; do the surfaces face outward?")
    return x, tets[:, [0, 2, 1, 3]]


def _main(given: str, made: str) -> None:
    import pytetwild  # heavy, and absent from what merely loads a template

    with np.load(given) as stored:
        v, f, p, c, h = (stored[k] for k in "vfpch")
        envelope, quality = stored["settings"]
    x, t = pytetwild.tetrahedralize(
        v, f.astype(np.int32),
        edge_length_abs=float(h.max()), epsilon=float(envelope / np.linalg.norm(np.ptp(v, axis=0))),
        stop_energy=float(quality), num_threads=1, quiet=False, loglevel=3,
        bg_vertices=p, bg_tets=c.astype(np.int32), bg_values=h,
    )  # fmt: skip
    np.savez(made, x=x, t=t)


if __name__ == "__main__":
    _main(*sys.argv[1:])
