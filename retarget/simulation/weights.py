"""The unit of the published weights: what a tet and a skin vertex of the paper's template stand for on another head.

Eqs (11) to (14), (A.5) and (A.6) add up tets of weight one, and the skin's terms vertex by vertex, on one mesh
(Table 2). Here tets weigh their volume in cm^3, so that the mesh does not matter; the weights of all other terms
(w_tar, w_F, handles) are multiplied by the volume that one tet of the paper's mesh would have on the head at hand. The
published numbers then balance tissue and targets on any mesh as they do on the paper's, with lengths in cm.
"""

from __future__ import annotations

from retarget.anatomy.boundary import signed_volumes
from retarget.anatomy.head import Head
from retarget.simulation.tetrahedra import MM3_PER_CM3

PAPER_SKIN = 29_826  # vertices, Table 2
PAPER_TETS = 126_612 + 107_437  # soft and muscle tissue, Table 2


def tet_of_weight_one(head: Head) -> float:
    """cm^3 of tissue that one of the paper's tets would have on this head."""
    return float(signed_volumes(head.vertices, head.template.tets).sum()) / MM3_PER_CM3 / PAPER_TETS
