"""Prints the tables of docs/simulation.md: `python docs/simulation_statistics.py [coarse|paper] [identities]`.

Every ARKit unit at full strength, on sampled heads: what the inverse simulation does to the tissue, and how far the
forward simulation on the same head comes back. About 10 minutes for three heads of the paper's size on 2 cores.
"""

from __future__ import annotations

import sys
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from retarget.anatomy.fit import fit_head
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.check import InvalidInput
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.simulation.state import HeadState
from retarget.types import FloatArray, Status
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.dataset import MakeHuman

MUSCLE_STRAINS = (0.01, 0.05, 0.2)


@dataclass(frozen=True)
class Row:
    """One unit on one head."""

    energy: float  # eqs (11) and (12) as printed, weighted by volume in cm^3
    rms: float  # mm, surface fit error over the set `head`
    largest: float  # mm
    inverted: int  # tets
    volume: float  # %, change of the whole tissue
    local: float  # %, mean of |det F - 1| by volume
    iterations: int
    status: Status
    back: float  # mm, largest distance from fwdSim(invSim(X)) to invSim(X) on the skin


def measure(head: Head, inverse: InverseSimulation, forward: ForwardSimulation | None, expression: FloatArray) -> Row:
    state = inverse(expression)
    miss = np.linalg.norm(state.skin - expression, axis=1)[head.template.regions.vertices["head"]]
    ratio, volumes = np.linalg.det(state.gradients), inverse.shape.volumes
    return Row(
        inverse.paper_energy(state),
        float(np.sqrt((miss**2).mean())),
        float(miss.max()),
        int((ratio <= 0).sum()),
        float(100 * (volumes @ ratio / volumes.sum() - 1)),
        float(100 * (volumes @ np.abs(ratio - 1) / volumes.sum())),
        state.info.iterations,
        state.info.status,
        _back(forward, state) if forward else np.nan,
    )


def _back(forward: ForwardSimulation, state: HeadState) -> float:
    return float(np.linalg.norm(forward(state.gradients, state.bones).skin - state.skin, axis=1).max())


def main(size: str = "coarse", identities: str = "3") -> None:
    data = MakeHuman(identities=int(identities), subdivisions=1).load()
    data = replace(data, weights=np.eye(len(SKIN_NAMES)), expressions=SKIN_NAMES)
    template = load_template(data.faces, data.regions, size)
    heads = {name: fit_head(template, data.neutral(name)) for name in data.identities}
    found: dict[str, list[Row]] = {unit: [] for unit in SKIN_NAMES}
    for name, head in heads.items():
        inverse, forward = InverseSimulation(head), ForwardSimulation(head, ForwardSettings(collisions=False))
        for i, unit in enumerate(SKIN_NAMES):
            try:
                found[unit].append(measure(head, inverse, forward, data.frames(name, [i])[0]))
            except InvalidInput as refusal:
                print(f"{name} {unit}: {refusal}", file=sys.stderr)
    print(f"\n{size}: {len(template.vertices)} vertices, {len(template.tets)} tets, heads {', '.join(heads)}\n")
    print("| unit | energy | fit rms, max mm | inverted | volume %, local % | iterations | there and back mm |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for unit, rows in found.items():
        print(f"| `{unit}` | {_line(rows)} |")
    print(Counter(row.status.value for rows in found.values() for row in rows))

    name, head = next(iter(heads.items()))
    print(f"\nmuscle strain, {size}, head {name}, means over units\n")
    print("| `muscle_strain` | fit rms mm | inverted tets | iterations |\n| --- | --- | --- | --- |")
    for strain in MUSCLE_STRAINS:
        inverse = InverseSimulation(head, InverseSettings(muscle_strain=strain))
        rows = [measure(head, inverse, None, data.frames(name, [i])[0]) for i in range(len(SKIN_NAMES))]
        means = [np.mean([getattr(row, part) for row in rows]) for part in ("rms", "inverted", "iterations")]
        print(f"| {strain} | {means[0]:.4f} | {means[1]:.1f} | {means[2]:.1f} |")


def _line(rows: list[Row]) -> str:
    def each(form: str) -> str:
        return " / ".join(form.format(row=row) for row in rows)

    return " | ".join(
        each(form)
        for form in (
            "{row.energy:.2f}",
            "{row.rms:.3f}, {row.largest:.2f}",
            "{row.inverted}",
            "{row.volume:+.2f}, {row.local:.2f}",
            "{row.iterations}",
            "{row.back:.0e}",
        )
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
