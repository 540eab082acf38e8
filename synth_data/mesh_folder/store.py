"""Meshes of a person in one file of plain numbers, which is made once and then mapped, never read whole.

Text is slow to read: 250 meshes of 30,000 vertices take seconds as OBJ and a fraction of a second from here.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, BinaryIO

import joblib
import numpy as np
from numpy.typing import NDArray

from retarget.check import InvalidInput
from retarget.io.files import write_whole
from synth_data.dataset import Progress
from synth_data.mesh_folder.likeness import Likeness
from synth_data.mesh_folder.listing import Files
from synth_data.mesh_folder.topology import Topology

FORMAT = 2  # raise it when what is stored, or how a file is read, changes
FOLDER = "meshes"
UNUSED = 30 * 86400.0  # seconds after which a file that no study read is removed
WORTH_PROCESSES = 100e6  # bytes of mesh files; fewer are read faster than processes start


@dataclass(frozen=True)
class Stored:
    """The meshes of one person as their files give them, in the files' unit and axes, rounded to float32."""

    path: Path  # .npy, (k, n, 3) float32
    names: tuple[str, ...]  # (k,)
    digests: tuple[str, ...]  # (k,) SHA-256 of each file
    extents: tuple[float, ...]  # (k,) longest side of the bounding box
    likeness: tuple[Likeness, ...]  # (k,) with the first

    def rows(self) -> NDArray[np.float32]:
        """(k, n, 3), mapped. Raises InvalidInput where the file is gone."""
        try:
            mapped: NDArray[np.float32] = np.load(self.path, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise InvalidInput(
                f"{self.path}: the stored meshes were removed or changed while they were in use; start the same "
                "command again."
            ) from error
        return mapped


def store_all(
    people: Mapping[str, Files], topology: Topology, cache: Path, jobs: int, progress: Progress
) -> dict[str, Stored]:
    """Store everybody whose files are new or changed. Raises InvalidInput for a mesh that cannot be used."""
    folder = cache / FOLDER
    paths = {identity: folder / f"{_key(files, topology)}.npy" for identity, files in people.items()}
    known = {identity: _known(path, topology) for identity, path in paths.items()}
    new = {identity: paths[identity] for identity, stored in known.items() if stored is None}
    if not new:
        return {identity: stored for identity, stored in known.items() if stored is not None}
    count = sum(len(people[identity]) for identity in new)
    _check_space(folder, count * topology.vertex_count * 12)
    size = sum(path.stat().st_size for identity in new for path in people[identity].values())
    progress(f"Reading {count:,} meshes ({size / 1e6:,.0f} MB) of {len(new)} people once, into {folder}")
    started, done = time.monotonic(), 0
    for identity, stored in _in_parallel(people, topology, new, jobs if size > WORTH_PROCESSES else 1):
        known[identity] = stored
        done += len(stored.names)
        seconds = time.monotonic() - started
        left = f", about {seconds / done * (count - done):.0f} s left" if done < count and seconds > 2 else ""
        progress(f"Read {identity}: {len(stored.names)} meshes{left}")
    _remove_unused(folder)
    return {identity: stored for identity, stored in known.items() if stored is not None}


def _in_parallel(
    people: Mapping[str, Files], topology: Topology, paths: Mapping[str, Path], jobs: int
) -> Iterator[tuple[str, Stored]]:
    tasks = [(people[identity], topology, path) for identity, path in paths.items()]
    if jobs == 1:
        yield from zip(paths, (_store(*task) for task in tasks), strict=True)
    else:
        parallel = joblib.Parallel(n_jobs=jobs, return_as="generator")
        yield from zip(paths, parallel(joblib.delayed(_store)(*task) for task in tasks), strict=True)


def _store(files: Files, topology: Topology, path: Path) -> Stored:
    """Read every file and write the array, then what is known about it: only both together count."""
    facts: dict[str, list[Any]] = {"names": list(files), "digests": [], "extents": [], "likeness": []}

    def save(temporary: Path) -> None:
        try:
            with temporary.open("wb") as file:
                _write_header(file, (len(files), topology.vertex_count, 3))
                neutral = None
                for mesh in files.values():
                    read = topology.read(mesh)
                    neutral = read.vertices if neutral is None else neutral
                    facts["digests"].append(read.digest)
                    facts["extents"].append(float(np.ptp(read.vertices, axis=0).max()))
                    facts["likeness"].append(astuple(Likeness.of(read.vertices, neutral, topology.faces)))
                    file.write(read.vertices.astype("<f4").tobytes())
        except InvalidInput:
            temporary.unlink(missing_ok=True)
            raise

    write_whole(path, save)
    write_whole(path.with_suffix(".json"), lambda temporary: temporary.write_text(json.dumps(facts)))
    return _stored(path, facts)


def _stored(path: Path, facts: Mapping[str, Sequence[Any]]) -> Stored:
    names, digests, extents, likeness = (tuple(facts[name]) for name in ("names", "digests", "extents", "likeness"))
    return Stored(path, names, digests, extents, tuple(Likeness(*numbers) for numbers in likeness))


def _write_header(file: BinaryIO, shape: tuple[int, ...]) -> None:
    np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})


def _known(path: Path, topology: Topology) -> Stored | None:
    """What is stored there, or None where it is absent or not whole."""
    try:
        stored = _stored(path, json.loads(path.with_suffix(".json").read_text()))
        shape = np.load(path, mmap_mode="r", allow_pickle=False).shape
        path.with_suffix(".json").touch()
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return stored if shape == (len(stored.names), topology.vertex_count, 3) else None


def _key(files: Files, topology: Topology) -> str:
    """Of what tells whether files changed without reading them: path, size and time of each."""
    facts: list[object] = [FORMAT, topology.vertex_count, hashlib.sha256(topology.faces.tobytes()).hexdigest()]
    for name, path in files.items():
        try:
            stat = path.stat()
        except OSError as error:
            raise InvalidInput(f"{path}: cannot be read ({error.strerror or error}); restore or remove it.") from error
        facts.append([name, str(path.absolute()), stat.st_size, stat.st_mtime_ns])
    return hashlib.sha256(json.dumps(facts).encode()).hexdigest()[:32]


def _check_space(folder: Path, needed: int) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise InvalidInput(
            f"dataset.cache: cannot write into {folder} ({error.strerror or error}), expected a folder that this user "
            "may write; set dataset.cache to one."
        ) from error
    if free < needed:
        raise InvalidInput(
            f"dataset.cache: {folder} has {free / 1e9:.1f} GB left, but the meshes need "
            f"{needed / 1e9:.1f} GB there. Free some space or set dataset.cache to a folder on another disk."
        )


def _remove_unused(folder: Path) -> None:
    for facts in folder.glob("*.json"):
        if time.time() - facts.stat().st_mtime > UNUSED:
            facts.unlink(missing_ok=True)
            facts.with_suffix(".npy").unlink(missing_ok=True)
