"""Named regions, loops and landmarks of the MakeHuman head: data in ``regions.json``, pictures in docs/regions.md."""

from __future__ import annotations

from functools import cache
from importlib import resources

from retarget.io.regions import decode
from retarget.types import Regions

FILE = "regions.json"


@cache
def load_regions() -> Regions:
    """Regions of the base head (4,328 vertices); docs/regions.md lists and shows every name.

    The character's left is +x. Names that come in pairs end in ``_left`` and ``_right``; the right one is the mirror
    image of the left one, in the same order.
    """
    return decode((resources.files(__package__) / FILE).read_text(), FILE)
