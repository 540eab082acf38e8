"""Artistic edits applied to anacon (AnaConDaR section 4.6).

Order: patch weights scale the draft and what it is held to; the inverse and the forward simulation run with the
edited stiffness, the forward one with the edited gravity; then control points pull the result. Each step that has
nothing to do leaves its input as it is.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from retarget.anatomical_transfer import Carried, Carrier
from retarget.artistic import Edits
from retarget.geometry.graph import vertex_adjacency
from retarget.geometry.space_warp import space_warp
from retarget.rig.blendshapes import Patches
from retarget.simulation.characteristics import (
    EYE_OPENINGS,
    EYE_SOCKETS,
    Characteristics,
    eye_triangles,
    lip_contour,
)
from retarget.simulation.forward import ForwardSimulation
from retarget.simulation.inverse import InverseSimulation
from retarget.simulation.materials import weight_change
from retarget.simulation.soft_terms import Handles
from retarget.simulation.state import HeadState
from retarget.types import FloatArray, Pair, Status

FADE = 4.0  # mm over which the strengths of neighbouring patches pass into each other
PULL = 1e5  # weight of a control point in the unit of Table 3, where the lip contour has 10


class Direction:
    """anacon of a pair's target, in the two steps of a `Carrier`, under edits."""

    def __init__(
        self, edits: Edits, pair: Pair, patches: Patches, anacon: Carrier, unedited: InverseSimulation
    ) -> None:
        """anacon: made with the edits' stiffness. unedited: its inverse simulation without."""
        self.edits, self.pair, self.anacon, self.unedited = edits, pair, anacon, unedited
        self.load = weight_change(edits.gravity)  # (3,) 1/mm
        self.strength = faded_strengths(pair, patches, edits.strengths)  # (n,)
        self._contour = lip_contour(pair.regions)
        self._leads = np.isin(edits.control.vertices, self._contour)  # (k,) the contour follows these
        own = edits.control.vertices[~self._leads]
        self.pulled = np.concatenate([self._contour, own]) if self._leads.any() else own  # (h,) skin vertices

    def unfollowed(self, draft: FloatArray, formed: HeadState) -> FloatArray:
        """(n, 3) mm: what tissue cannot follow of a draft (n, 3) mm, without that which the edit of the stiffness
        takes from the head `formed`."""
        plain = formed if self.unedited is self.anacon.inverse else self.unedited(draft, formed)
        return draft - plain.skin

    def take(
        self, formed: HeadState, wanted: Characteristics | None = None, detail: FloatArray | float = 0.0
    ) -> Carried:
        """The head held to characteristics, under the edited gravity and pulled by the control points.

        detail (n, 3) mm is what the skin carries on top of what tissue does.
        """

        def simulated(
            forward: ForwardSimulation, wanted: Characteristics | None, goals: FloatArray | None = None
        ) -> Carried:
            skin = forward.with_detail(detail)
            return Carried(formed, skin(formed.gradients, formed.bones, 1.0, wanted, goals, self.load))

        done = simulated(self.anacon.forward, wanted)
        if not len(self.pulled) or done.info.status is Status.FAILED:
            return done
        displacements = self.displacements(done.skin)
        if not displacements.any():
            return done
        if wanted is not None and wanted.lip_contour is not None and self._leads.any():
            wanted = replace(wanted, lip_contour=wanted.lip_contour + displacements[: len(self._contour)])
        return simulated(self._pulling, wanted, done.skin[self.pulled] + displacements)

    def strengthened(self, skin: FloatArray) -> FloatArray:
        """A target's expression (n, 3) mm with its motion times the strength of its patches.

        T_i^P gets the strength times w, as in ALM. The missing blendshape is scaled as well, and so are
        `characteristics`: how strong an expression gets then does not depend on how much of it examples explain.
        """
        if (self.strength == 1).all():
            return skin
        neutral = self.pair.target_neutral
        scaled: FloatArray = neutral + self.strength[:, None] * (skin - neutral)
        return scaled

    def characteristics(self, wanted: Characteristics) -> Characteristics:
        """What an expression is held to, by the strength of its patches."""
        if (self.strength == 1).all():
            return wanted
        lips = wanted.lip_contour
        if lips is not None:
            neutral = self.pair.target_neutral[self._contour]
            lips = neutral + self.strength[self._contour, None] * (lips - neutral)

        def scaled(ratios: FloatArray | None, names: tuple[str, ...]) -> FloatArray | None:
            if ratios is None:
                return None
            strength = self.strength[eye_triangles(self.pair.regions, names)].mean(axis=1)
            return np.maximum(1 + strength * (ratios - 1), 0.0)

        return Characteristics(scaled(wanted.eye_opening, EYE_OPENINGS), scaled(wanted.eye_socket, EYE_SOCKETS), lips)

    def displacements(self, skin: FloatArray) -> FloatArray:
        """(h, 3) mm of the vertices `pulled` from a result (n, 3) mm: the warped contour, then points of their own."""
        control, leads = self.edits.control, self._leads
        moves = control.displacements(skin)
        if not leads.any():
            return moves
        warp = space_warp(skin[control.vertices[leads]], moves[leads])
        return np.vstack([warp(skin[self._contour]), moves[~leads]])

    @cached_property
    def _pulling(self) -> ForwardSimulation:
        return self.anacon.forward.with_handles(Handles(skin=self.pulled, weights=PULL))


def faded_strengths(pair: Pair, patches: Patches, strengths: FloatArray) -> FloatArray:
    """(n,) factors from those of the patches (p,), which pass into each other over some FADE millimetres.

    (I - FADE^2 Laplacian) s = s0, so all lie between the smallest and the largest.
    # differs from ALM, which has jumps: anacon follows its draft too closely to smooth them away.
    """
    count = len(pair.target_neutral)
    if (strengths == strengths[0]).all():
        return np.full(count, strengths[0])
    given = np.empty(count)
    for patch, strength in zip(patches, strengths, strict=True):
        given[patch] = strength
    edges = vertex_adjacency(pair.faces, count).tocoo()
    lengths = np.linalg.norm(pair.target_neutral[edges.row] - pair.target_neutral[edges.col], axis=1)
    weights = sp.csr_array((FADE**2 / (1.5 * lengths**2), (edges.row, edges.col)), shape=(count, count))
    system = sp.diags_array(1 + weights.sum(axis=1)) - weights  # 6 neighbours at h: sum (f_j - f_i) = 1.5 h^2 Laplacian
    faded: FloatArray = spsolve(sp.csc_array(system), given)
    return faded
