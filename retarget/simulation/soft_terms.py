"""The soft terms of the forward simulation as rows on points of the skin: lip contour, eyes, handles."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp

from retarget.anatomy.head import Head
from retarget.check import InvalidInput, check_points
from retarget.simulation.area_terms import area_terms
from retarget.simulation.characteristics import (
    EYE_OPENINGS,
    EYE_SOCKETS,
    Characteristics,
    eye_triangles,
    lip_contour,
)
from retarget.simulation.condensed import SoftRows
from retarget.simulation.projective_dynamics import LENGTH_UNIT
from retarget.simulation.weights import tet_of_weight_one
from retarget.types import FloatArray, IntArray

NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class SoftWeights:
    """Weights of the parts of eq. (A.1), in the unit of `weights.tet_of_weight_one`; 0 leaves one out."""

    lip_contour: float
    eye_opening: float
    eye_socket: float


@dataclass(frozen=True)
class Handles:
    """Soft Dirichlet constraints for artistic control: points of the skin, then vertices of the tets."""

    skin: IntArray = field(default_factory=NONE.copy)  # (a,) indices of skin vertices
    vertices: IntArray = field(default_factory=NONE.copy)  # (b,) indices of tet vertices
    weights: float | FloatArray = 1000.0  # one number or (a + b,), > 0, in the unit of Table 3's weights

    @property
    def count(self) -> int:
        return len(self.skin) + len(self.vertices)


@dataclass(frozen=True)
class Goals:
    """What the soft terms of one expression want; `active` names the terms in use."""

    active: tuple[str, ...]
    targets: FloatArray  # (r, 3) mm, of the rows with fixed targets
    ratios: FloatArray  # (k,) of the triangles with a wanted area


class SoftTerms:
    """The points that soft terms of a head act on, C x + offset, and the rows of each term on them."""

    def __init__(self, head: Head, weights: SoftWeights, more: IntArray = NONE) -> None:
        """more: skin vertices that need to be points as well."""
        regions = head.template.regions
        self.head, self.weights = head, weights
        unit = tet_of_weight_one(head)
        contour = lip_contour(regions)
        triangles = {
            term: eye_triangles(regions, names)
            for term, names in (("eye_opening", EYE_OPENINGS), ("eye_socket", EYE_SOCKETS))
        }
        used = np.concatenate([contour, *(faces.ravel() for faces in triangles.values())])
        self.skin = np.union1d(used, more)  # (p,)
        self.points = sp.csr_array(head.template.embedding[self.skin])  # C (p, m)
        self.offset = head.residual[self.skin]  # (p, 3) mm
        self.place = np.full(len(head.skin), -1)  # of each skin vertex among the points
        self.place[self.skin] = np.arange(len(self.skin))

        self._rows = {}
        self._kept: dict[str, IntArray] = {}
        self._counts = {"lip_contour": len(contour)} | {term: len(t) for term, t in triangles.items()}
        if len(contour) and weights.lip_contour > 0:  # eq. (A.4)
            pick = sp.eye_array(len(self.skin), format="csr")[self.place[contour]]
            self._rows["lip_contour"] = SoftRows(
                pick, np.full(len(contour), unit * weights.lip_contour / LENGTH_UNIT**2)
            )
        for term, faces in triangles.items():  # eqs (A.2), (A.3)
            areas = area_terms(head.skin[self.skin], self.place[faces])
            if len(areas.kept) and getattr(weights, term) > 0:
                self._kept[term] = areas.kept
                self._rows[term] = SoftRows(areas.operator, np.repeat(unit * getattr(weights, term) * areas.weights, 2))

    def goals(self, given: Characteristics) -> Goals:
        """Raises InvalidInput for characteristics that do not fit this topology or are not finite."""
        active, targets, ratios = [], np.empty((0, 3)), [np.empty(0)]
        if given.lip_contour is not None:
            contour = check_points(
                "characteristics.lip_contour", given.lip_contour, self._counts["lip_contour"], "vertex of the loop"
            )
            if "lip_contour" in self._rows:
                active, targets = ["lip_contour"], contour
        for term in ("eye_opening", "eye_socket"):
            wanted = getattr(given, term)
            if wanted is None:
                continue
            if wanted.shape != (self._counts[term],) or not (np.isfinite(wanted).all() and (wanted >= 0).all()):
                raise InvalidInput(
                    f"characteristics.{term}: expected {self._counts[term]} finite area ratios >= 0, one for each "
                    f"triangle of the patches, got {wanted.shape}; make them with this topology's regions."
                )
            if term in self._rows:
                active.append(term)
                ratios.append(wanted[self._kept[term]])
        return Goals(tuple(active), targets, np.concatenate(ratios))

    def rows(self, goals: Goals) -> tuple[SoftRows, SoftRows]:
        """The rows with fixed targets and those of triangles, on p points."""
        fixed = [self._rows[term] for term in goals.active if term == "lip_contour"]  # eq. (A.1) is the sum of both
        areas = [self._rows[term] for term in goals.active if term != "lip_contour"]
        return SoftRows.stack(fixed, len(self.skin)), SoftRows.stack(areas, len(self.skin))


def handle_points(head: Head, handles: Handles) -> tuple[sp.csr_array, FloatArray, FloatArray]:
    """C (h, m), offset (h, 3) mm and weights (h,) in 1/mm^2 of handles. Raises InvalidInput for what does not fit."""
    skin, vertices = (np.asarray(part, dtype=np.int64) for part in (handles.skin, handles.vertices))
    for name, part, count in (("skin", skin, len(head.skin)), ("vertices", vertices, len(head.vertices))):
        if len(part) and not 0 <= part.min() <= part.max() < count:
            raise InvalidInput(
                f"handles.{name}: expected indices from 0 to {count - 1}, got {part.min()} to {part.max()}."
            )
    weights = np.broadcast_to(np.asarray(handles.weights, dtype=np.float64), (handles.count,))
    if not (np.isfinite(weights).all() and (weights > 0).all()):
        raise InvalidInput("handles.weights: expected finite numbers > 0, one or one for each handle.")
    pick = sp.eye_array(len(head.vertices), format="csr")[vertices]
    points = sp.csr_array(sp.vstack([head.template.embedding[skin], pick]))
    return (
        points,
        np.vstack([head.residual[skin], np.zeros((len(vertices), 3))]),
        weights * tet_of_weight_one(head) / LENGTH_UNIT**2,
    )
