"""What the tissue under a prediction would have to do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from experiments.metrics.metric import Comparison, Measurement, Metric, lacking
from retarget.anatomical_transfer import AnatomySettings
from retarget.anatomy.boundary import signed_volumes
from retarget.anatomy.template import check_size
from retarget.character import Character, Topology
from retarget.types import FloatArray, Regions, Status

NOT_FORMED = 100.0  # %, of a prediction that no head forms


@dataclass(frozen=True)
class Tissue(Metric):
    """Change of volume and share of inverted tets of the head that forms a prediction, both in %.

    The inverse simulation of eq. (8) finds what the tissue of the target's head does to look like the prediction.
    `tissue_volume_change` is the mean of |det F - 1| over its volume, `inverted_tets` the share with det F <= 0. A
    prediction that the simulation cannot form counts as 100 %. It sees what this project's own model of a head sees:
    AnaConDaR, whose last step is the same simulation, is at an advantage. No truth enters (reference row `truth`).
    """

    template: str = "coarse"

    def __post_init__(self) -> None:
        check_size(self.template)

    def unsupported(self, regions: Regions) -> str | None:
        return lacking("points", ["condyle_left", "condyle_right"], regions.points)

    def __call__(self, comparison: Comparison) -> Iterator[Measurement]:
        topology = Topology.of(comparison.faces, comparison.regions)
        character = Character.of(topology, self.template, comparison.target_neutral)
        settings = AnatomySettings(template=self.template)
        simulation = character.inverse(settings.inverse_settings, settings.tets)
        volumes = signed_volumes(character.head.vertices, character.head.template.tets)
        change, inverted = np.full((2, len(comparison.retargeted)), NOT_FORMED)
        for i, frame in enumerate(comparison.retargeted):
            state = simulation(frame)
            if state.info.status is Status.FAILED:
                continue
            change[i], inverted[i] = strain(state.gradients, volumes)
        yield Measurement("tissue_volume_change", "tissue", "%", "lower", change)
        yield Measurement("inverted_tets", "tissue", "%", "lower", inverted)


def strain(gradients: FloatArray, volumes: FloatArray) -> tuple[float, float]:
    """(mean of |det F - 1| over the volume, share of inverted tets), both in %, of F (m, 3, 3) and volumes (m,)."""
    determinants = np.linalg.det(gradients)
    change = np.abs(determinants - 1) @ volumes / volumes.sum()
    return 100 * float(change), 100 * float((determinants <= 0).mean())
