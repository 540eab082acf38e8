"""MakeHuman's 51 ARKit units as the rig that all of its people share."""

from __future__ import annotations

import numpy as np

from retarget.types import FloatArray, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.head import BaseHead
from synth_data.makehuman.identities import Identity
from synth_data.makehuman.targets import Targets
from synth_data.personal.traits import draw_traits
from synth_data.truth import GenericRig, Person
from synth_data.truths.personal_blendshapes import personal_deltas


def generic_rig(head: BaseHead, targets: Targets, regions: Regions) -> GenericRig:
    """The face units on the base head, made symmetric: the artist's sides differ by up to 2.2 mm (mouthFunnel)."""
    units = np.stack([targets[f"units/{name}"] for name in SKIN_NAMES])
    return GenericRig(head.vertices, head.faces, units, regions).symmetrised()


def person_of(identity: Identity) -> Person:
    """Identity, seed and age of a synthetic adult as a truth needs them."""
    return Person(identity.vertices, draw_traits(identity.seed, identity.age))


def personal_rig(identity: Identity, head: BaseHead, targets: Targets, regions: Regions) -> FloatArray:
    """(51, n, 3) mm: the displacements of an identity under the truth `personal_blendshapes`."""
    return personal_deltas(person_of(identity), generic_rig(head, targets, regions))
