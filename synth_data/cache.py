"""Arrays that take long to make, kept in the user's cache folder under a fingerprint of all that decides them."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from retarget.check import InvalidInput
from retarget.io.files import cache_folder, write_whole
from retarget.types import FloatArray, IntArray

FOLDER = "truth"
LARGEST = 2 * 2**30  # bytes that the folder may hold; what was not read for longest goes first


def fingerprint(parts: Iterable[str | bytes | FloatArray | IntArray]) -> str:
    """SHA-256 over texts, bytes and arrays, each with its length or shape."""
    digest = hashlib.sha256()
    for part in parts:
        if isinstance(part, np.ndarray):
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(part).tobytes())
        else:
            data = part.encode() if isinstance(part, str) else part
            digest.update(f"{len(data)} ".encode() + data)
    return digest.hexdigest()


@dataclass(frozen=True)
class ArrayCache:
    """Float arrays by fingerprint, one `.npy` file each, written whole. Without a folder nothing is kept."""

    folder: Path | None = None

    @classmethod
    def of(cls, cache: str | Path | None) -> ArrayCache:
        """In the folder `cache`, by default the user's."""
        return cls(cache_folder(cache) / FOLDER)

    def __call__(self, key: str, make: Callable[[], FloatArray]) -> FloatArray:
        """The array of this key, read-only, mapped from its file; made and stored if there is none that can be read.

        A folder that cannot be written costs time at the next start and nothing else.
        """
        if self.folder is None:
            return make()
        path = self.folder / f"{key}.npy"
        if (stored := _read(path)) is not None:
            return stored
        made = np.ascontiguousarray(make(), dtype=np.float64)

        def save(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.save(file, made, allow_pickle=False)

        try:
            write_whole(path, save)
            self._prune(path)
        except InvalidInput:
            return made
        stored = _read(path)
        return made if stored is None else stored

    def has(self, key: str) -> bool:
        """Whether an array of this key is stored."""
        return self.folder is not None and (self.folder / f"{key}.npy").is_file()

    def _prune(self, newest: Path) -> None:
        """Remove what was not read for longest, until the folder is small enough."""
        assert self.folder is not None
        files = []
        for path in self.folder.glob("*.npy"):
            try:
                files.append((path.stat().st_mtime, path.stat().st_size, path))
            except OSError:  # another process removed it
                continue
        excess = sum(size for _, size, _ in files) - LARGEST
        for _, size, path in sorted(files):
            if excess <= 0:
                return
            if path != newest:
                path.unlink(missing_ok=True)
                excess -= size


def _read(path: Path) -> FloatArray | None:
    """The array, or None where there is none or it is damaged."""
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    with contextlib.suppress(OSError):  # a folder that is only read keeps no record of what was used last
        path.touch()
    return np.asarray(array) if array.dtype == np.float64 else None
