"""Named regions, loops and landmarks of ICT-FaceKit's skin: data in ``regions.json``, see docs/ict_facekit.md."""

from __future__ import annotations

from functools import cache
from importlib import resources

from retarget.io.regions import decode
from retarget.types import Regions

FILE = "regions.json"


@cache
def load_regions() -> Regions:
    """Regions of the skin (14,062 vertices), by the names of docs/regions.md."""
    return decode((resources.files(__package__) / FILE).read_text(), FILE)
