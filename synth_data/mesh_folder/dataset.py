"""Dataset `mesh_folder`: a user's meshes, `identity/expression.obj|ply|npz`, in one topology."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from retarget.anatomy.skin import isolate_skin
from retarget.check import InvalidInput
from retarget.geometry.graph import components, vertex_adjacency
from retarget.io.files import cache_folder
from retarget.io.landmarks import read_landmarks
from retarget.io.regions import read_regions
from retarget.suggest import choose
from retarget.types import FloatArray, IntArray, Regions
from synth_data.cache import fingerprint
from synth_data.dataset import Conditions, Dataset, DatasetConfig, Progress
from synth_data.mesh_folder import summary
from synth_data.mesh_folder.likeness import Likeness, check_alike
from synth_data.mesh_folder.listing import LAYOUT, Listing, list_folder
from synth_data.mesh_folder.placement import (
    Align,
    Frame,
    Poses,
    check_rigid,
    check_sizes,
    check_still,
    check_upright,
    cranium_of,
    poses,
    unmoved,
)
from synth_data.mesh_folder.store import Stored, store_all
from synth_data.mesh_folder.topology import Topology
from synth_data.noise import check_noise

REGIONS = "regions.json"  # in the folder that `experiments.topology transfer` writes


@dataclass(frozen=True)
class MeshFolder(DatasetConfig):
    """Settings of the dataset; docs/own_scans.md says what the folder must hold."""

    root: str | None = None  # the folder: identity/expression.obj
    identities: int | Sequence[str] | None = None  # the first so many, or which; None: all
    neutral: str | int | None = None  # name of the meshes at rest, 5 for 5.obj; None: found by its name
    units: str = "mm"  # mm | cm | dm | m | inch
    up: str = "+y"  # axis of the files along which the top of the head lies
    front: str = "+z"  # axis of the files along which the face looks
    align: str = "load"  # one of `Align`
    regions: str | None = None  # regions of this topology, docs/own_topology.md
    landmarks: str | None = None  # where meshes hold eyeballs or teeth: the landmarks the regions were made from
    noise_mm: float = 0.0  # RMS length of further noise on all that a method sees
    cache: str | None = None  # a folder; by default the user's
    jobs: int = -1  # processes that read meshes; -1: one for each core

    def load(self, progress: Progress = lambda line: None) -> MeshFolderDataset:
        """List, check and store the meshes. Raises InvalidInput that names the file and the mend."""
        if not self.root:
            raise InvalidInput(f"dataset.root: expected a folder of meshes, set dataset.root=/path/to/it. {LAYOUT}")
        self._check_texts()
        root = Path(self.root).expanduser()
        frame, noise = Frame.of(self.units, self.up, self.front), check_noise("dataset.noise_mm", self.noise_mm)
        align = Align(choose("dataset.align", self.align, list(Align)))
        if not isinstance(self.jobs, int) or self.jobs == 0:
            raise InvalidInput(f"dataset.jobs: expected a number of processes or -1 for all cores, got {self.jobs!r}.")
        listing = list_folder(root, None if self.neutral is None else str(self.neutral), self.identities)
        first = listing.identities[0]
        topology = Topology.of(listing.files[first][listing.neutral])
        kept, faces, regions = self._skin(topology)
        cranium = cranium_of(regions, align)
        count = len(listing.expressions)
        progress(
            f"{len(listing.files)} people x {count} expressions besides '{listing.neutral}', "
            f"{topology.vertex_count:,} vertices, in {root} ({self.units}, {self.up} up, {self.front} front)"
        )
        cache = cache_folder(self.cache)
        stored = store_all(listing.files, topology, cache, self.jobs, progress)
        check_sizes(listing.files, stored, self.units)
        raw = {identity: _Raw(meshes, frame, kept) for identity, meshes in stored.items()}
        start = raw[first].mesh(0)
        if regions is not None:
            check_upright(topology.file, start, regions)
        neutrals = {identity: Likeness.of(meshes.mesh(0), start, faces) for identity, meshes in raw.items()}
        check_alike(listing.files, {identity: found.likeness for identity, found in stored.items()}, neutrals)
        placed = _placed(listing, raw, cranium, align)
        for line in summary.table(listing, {name: meshes.size() for name, meshes in raw.items()}, placed, align):
            progress(line)
        for line in summary.left_out(listing):
            progress(line)
        everything = np.arange(topology.vertex_count if kept is None else len(kept))
        return MeshFolderDataset(
            conditions=Conditions(f"mesh_folder:{root.resolve().name}", "scans", "scans", noise),
            faces=faces,
            regions=Regions(vertices={"head": everything}) if regions is None else regions,
            identities=listing.identities,
            expressions=listing.expressions,
            favours=summary.favours(listing, placed, align),
            fingerprint=self._fingerprint(stored, topology),
            meshes=raw,
            placed=placed,
        )

    def _check_texts(self) -> None:
        """Raises InvalidInput for a number, a list or null where a setting is text: YAML reads 5 as a number."""
        for setting in fields(self):
            value, needed = getattr(self, setting.name), setting.type == "str"
            if (needed or (setting.type == "str | None" and value is not None)) and not isinstance(value, str):
                expected = f"text such as {setting.default!r}" if needed else "a path (./5 for one that is named 5)"
                got = "null" if value is None else repr(value)
                raise InvalidInput(f"dataset.{setting.name}: expected {expected}, got {got}.")

    def _skin(self, topology: Topology) -> tuple[IntArray | None, IntArray, Regions | None]:
        """The vertices to keep (None: all), the triangles (f, 3) in their numbers, and the regions where there are."""
        kept, faces, count = None, topology.faces, topology.vertex_count
        if self.landmarks is not None:
            _, marks = read_landmarks(Path(self.landmarks).expanduser())
            kept, faces = isolate_skin(faces, count, marks)
            count = len(kept)
        if self.regions is None:
            return kept, faces, None
        try:
            return kept, faces, read_regions(self._regions_file(), count, faces)
        except InvalidInput as error:
            pieces = len(components(vertex_adjacency(faces, count)))
            if pieces == 1:
                raise
            raise InvalidInput(
                f"{error} The meshes consist of {pieces} pieces, such as eyeballs and teeth: if the regions were made "
                "of the skin alone, set dataset.landmarks to the landmarks file that they were made from."
            ) from error

    def _regions_file(self) -> Path:
        path = Path(str(self.regions)).expanduser()
        return path / REGIONS if path.is_dir() else path

    def _fingerprint(self, stored: Mapping[str, Stored], topology: Topology) -> str:
        """SHA-256 over the contents of all files that are used, and the settings that decide where meshes go."""
        parts: list[str | bytes] = [
            repr((self.units, self.up, self.front, self.align, float(self.noise_mm))),
            topology.faces.tobytes(),
        ]
        for identity, meshes in stored.items():
            parts += [identity, *meshes.names, *meshes.digests]
        for file in (None if self.regions is None else self._regions_file(), self.landmarks):
            parts.append(b"" if file is None else Path(file).expanduser().read_bytes())
        return fingerprint(parts)


def _placed(listing: Listing, raw: Mapping[str, _Raw], cranium: IntArray | None, align: Align) -> dict[str, Poses]:
    """Where the meshes of each person go; the first person's neutral stays where it is."""
    placed: dict[str, Poses] = {}
    reference: FloatArray | None = None
    for identity, meshes in raw.items():
        if cranium is None:
            placed[identity] = unmoved(len(meshes.stored.names))
            continue
        crania = meshes.part(cranium)
        placed[identity] = poses(crania, 0, reference, align)
        check_rigid(listing.files[identity], placed[identity])
        reference = crania[0] if reference is None else reference
        if align is Align.REFUSE:
            check_still(listing.files[identity], placed[identity])
    return placed


@dataclass(frozen=True)
class _Raw:
    """The stored meshes of a person in mm and this project's axes, where the scanner saw them."""

    stored: Stored
    frame: Frame
    kept: IntArray | None  # vertices, None: all

    def mesh(self, row: int) -> FloatArray:
        """(n, 3) mm."""
        mesh = self.stored.rows()[row]
        return self.frame(mesh if self.kept is None else mesh[self.kept])

    def part(self, members: IntArray) -> FloatArray:
        """(k, m, 3) mm of all meshes."""
        members = members if self.kept is None else self.kept[members]
        return self.frame(np.array([mesh[members] for mesh in self.stored.rows()]))

    def size(self) -> FloatArray:
        """(3,) mm: width, height and depth of the neutral."""
        return np.ptp(self.mesh(0), axis=0)


@dataclass(frozen=True, eq=False)
class MeshFolderDataset(Dataset):
    """The listed dataset. Meshes are mapped from the store when they are asked for, and placed then."""

    conditions: Conditions
    faces: IntArray
    regions: Regions
    identities: tuple[str, ...]
    expressions: tuple[str, ...]
    favours: str
    fingerprint: str
    meshes: Mapping[str, _Raw]  # row 0 is the neutral, row i + 1 expression i
    placed: Mapping[str, Poses]

    def neutral(self, identity: str) -> FloatArray:
        return self._rows(identity, [0])[0]

    def frames(self, identity: str, indices: Sequence[int]) -> FloatArray:
        return self._rows(identity, (self.chosen(indices, "the folder has no more") + 1).tolist())

    def _rows(self, identity: str, rows: Sequence[int]) -> FloatArray:
        raw, placed = self.meshes[self.known(identity)], self.placed[identity]
        count = len(raw.stored.rows()[0] if raw.kept is None else raw.kept)
        frames = np.empty((len(rows), count, 3))
        for frame, row in zip(frames, rows, strict=True):
            frame[:] = raw.mesh(row) @ placed.rotations[row].T + placed.translations[row]
        return frames
