"""Facial retargeting: the protocol of a method, mesh and rig operators, and the methods built from them."""

from retarget.check import InvalidInput, UnsupportedProblem
from retarget.types import Examples, Pair, Regions, Retargeter, RetargetProblem, RetargetResult, SolveInfo, Status

__all__ = [
    "Examples",
    "InvalidInput",
    "Pair",
    "Regions",
    "RetargetProblem",
    "RetargetResult",
    "Retargeter",
    "SolveInfo",
    "Status",
    "UnsupportedProblem",
]
