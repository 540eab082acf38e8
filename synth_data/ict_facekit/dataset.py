"""ICT-FaceKit as a dataset: people sampled from its identity modes perform by any kind of truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from synth_data.cache import ArrayCache
from synth_data.dataset import Progress
from synth_data.ict_facekit.clone import find_clone
from synth_data.ict_facekit.identities import IdentitySampler
from synth_data.ict_facekit.model import read_model
from synth_data.ict_facekit.regions import load_regions
from synth_data.performed import PerformedConfig, Troupe
from synth_data.truth import GenericRig


@dataclass(frozen=True)
class IctFaceKit(PerformedConfig):
    """Settings of the dataset; docs/ict_facekit.md says what it is and what must not be claimed from it."""

    root: str | None = None  # the user's clone of https://github.com/ICT-VGL/ICT-FaceKit

    name: ClassVar[str] = "ict_facekit"
    package: ClassVar[str] = "synth_data.ict_facekit"
    paths: ClassVar[Mapping[str, str]] = {**PerformedConfig.paths, "root": "a clone of ICT-FaceKit"}
    elsewhere: ClassVar[frozenset[str]] = PerformedConfig.elsewhere | {"root"}

    def source(self) -> str:
        """Digest of the clone's files that are used. Raises InvalidInput that names the file and the mend."""
        return find_clone(self.root).digest()

    def troupe(self, progress: Progress) -> Troupe:
        """Raises InvalidInput for a clone that is incomplete, damaged or of another topology."""
        clone, regions = find_clone(self.root), load_regions()
        model = read_model(clone, clone.digest(), ArrayCache.of(self.cache), progress)
        sample = IdentitySampler(model, regions)
        people = {}
        for number, (name, seed) in enumerate(self.seeds().items(), 1):
            progress(f"Sampling identity {number} of {self.identities} from {len(model.modes)} modes")
            people[name] = sample(seed)
        return Troupe(
            GenericRig(sample.neutral, model.faces, model.units, regions), people, faces=model.faces, regions=regions
        )
