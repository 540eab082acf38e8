"""Colours of figures: safe for colour-blind readers, light where shapes must stay visible."""

from __future__ import annotations

from matplotlib.colors import LinearSegmentedColormap

SKIN = "#d9bba8"
ERROR_COLORMAP = LinearSegmentedColormap.from_list(
    "error", ["#f3efe9", "#fbdf9f", "#f7a660", "#e25a5b", "#a3216f", "#43105f"]
)  # light at the low end: the shape stays visible where the error is small

_METHODS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#B8A800",
    "#6A3D9A",
    "#8C564B",
    "#222222",
    "#E377C2",
    "#17A3A3",
    "#7A5C00",
    "#8FBF3F",
    "#7B1E3A",
    "#8C8FE0",
)
COLORS = len(_METHODS)
REFERENCE_ROW = "#9A9A9A"


def method_color(index: int) -> str:
    """The colour of the index-th compared method, the first after Okabe and Ito (2008); they repeat after `COLORS`."""
    return _METHODS[index % COLORS]
