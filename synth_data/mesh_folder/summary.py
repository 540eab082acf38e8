"""What was read, in words and numbers, for the terminal and the report."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from retarget.types import FloatArray
from synth_data.mesh_folder.listing import Listing
from synth_data.mesh_folder.placement import STILL_DEGREES, STILL_MM, Align, Poses


def table(listing: Listing, sizes: Mapping[str, FloatArray], removed: Mapping[str, Poses], align: Align) -> list[str]:
    """Lines: a head and one row for each identity. sizes: (3,) mm width, height and depth of the neutrals."""
    head = ["identity", "width", "height", "depth (mm)"]
    if align is not Align.NONE:
        what = "removed: turn" if align is Align.LOAD else "found: turn"
        head += [f"{what} (median, most, degrees)", "shift (median, most, mm)", "most in", "left (most, mm RMS)"]
    rows = [head]
    for identity, size in sizes.items():
        row = [identity, *(f"{side:.0f}" for side in size)]
        if align is not Align.NONE:
            poses = removed[identity]
            worst = int(np.argmax(np.maximum(poses.degrees / STILL_DEGREES, poses.shifts / STILL_MM)[1:]))
            row += [
                *(f"{np.median(values[1:]):.2f}, {values[1:].max():.2f}" for values in (poses.degrees, poses.shifts)),
                listing.expressions[worst],
                f"{poses.residuals[1:].max():.2f}",
            ]
        rows.append(row)
    widths = [max(len(row[column]) for row in rows) for column in range(len(head))]
    return ["  ".join(map(_aligned, range(len(row)), row, widths)).rstrip() for row in rows]


def _aligned(column: int, cell: str, width: int) -> str:
    """Names stand on the left, numbers on the right."""
    return cell.ljust(width) if column in (0, 6) else cell.rjust(width)


def left_out(listing: Listing) -> Iterator[str]:
    """A line for each person who lacks expressions that others have, and for folders that are no person."""
    for identity, names in listing.lacking.items():
        if names:
            yield f"left out, because {identity} has no mesh of it: {', '.join(names)}"
    for name, why in listing.passed_over.items():
        yield f"passed over: the folder {name} {why}"


def favours(listing: Listing, removed: Mapping[str, Poses], align: Align) -> str:
    """For the report: what this truth resembles, and what it cannot show."""
    said = [
        "The ground truth are meshes of the user's own folder; none was synthesised here. Whom it favours depends on "
        "how they were made: meshes that were tracked with a blendshape model, or completed by deformation transfer, "
        "favour methods of that kind, and noise of scanner and registration is part of the error of every method. "
        "Files of one name are taken for the same expression: where people perform it differently, no method can be "
        "right, and people repeat a posed smile within some 1.5 mm."
    ]
    if align is Align.LOAD:
        degrees = max(poses.degrees.max() for poses in removed.values())
        shift = max(poses.shifts.max() for poses in removed.values())
        said.append(
            "Every mesh was aligned rigidly on the cranium of the person's neutral, and the neutrals on the first "
            f"person's; sizes are kept. Removed were up to {degrees:.1f} degrees and {shift:.1f} mm of head motion."
        )
    elif align is Align.REFUSE:
        said.append(
            f"No mesh was moved; no cranium turns by more than {STILL_DEGREES:g} degree or shifts by more than "
            f"{STILL_MM:g} mm."
        )
    else:
        said.append("No mesh was moved, and nothing was checked for head motion, which would count as error.")
    if dropped := {name for names in listing.lacking.values() for name in names}:
        said.append(
            f"{len(dropped)} expressions were left out, because not everybody has a mesh of them: "
            f"{', '.join(sorted(dropped))}."
        )
    return " ".join(said)
