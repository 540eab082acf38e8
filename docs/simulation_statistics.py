"""The statistics of docs/simulation.md: `python docs/simulation_statistics.py [coarse paper]`.

Every ARKit unit at full strength, on four sampled heads and an exaggerated one: what the inverse simulation does to the
tissue, and how far the forward simulation on the same head comes back to the expression. Writes all solves to
docs/data/simulation_statistics.csv and prints the tables. About 2 minutes for coarse and 15 for paper on one core.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd

from retarget.anatomy.fit import fit_head
from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSettings, InverseSimulation
from retarget.types import FloatArray
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.rig import personal_rig
from synth_data.makehuman.subdivide import Subdivision, subdivide
from synth_data.makehuman.targets import load_head

TABLE = Path(__file__).parent / "data" / "simulation_statistics.csv"
SAMPLED = 4
EXAGGERATED, FACTOR, MEAN_OF = 3, 1.5, 20  # this seed at 1.5 times its distance from the mean of 20
MUSCLE_STRAINS = (0.01, 0.05, 0.2)
COLUMNS = {  # of the printed table: name and format of median and worst
    "fit_rms": ("fit rms mm", "{:.3f}"),
    "fit_max": ("fit max mm", "{:.1f}"),
    "inverted": ("inverted", "{:.0f}"),
    "volume": ("volume %", "{:+.2f}"),
    "energy": ("energy", "{:.1f}"),
    "iterations": ("iterations", "{:.0f}"),
}
Row = dict[str, float | int | str]
Characters = dict[str, tuple[FloatArray, FloatArray]]  # neutral (n, 3) and what the units add (51, n, 3), mm


def characters() -> tuple[Subdivision, Characters]:
    """The heads of the table on the dataset's default resolution."""
    base, targets = load_head()
    regions = load_regions()
    fine = subdivide(base.faces, len(base.vertices))
    sampler = IdentitySampler(base, targets, regions)
    people = [sampler(seed) for seed in range(MEAN_OF)]
    found = {
        f"person-{seed:03d}": (fine(people[seed].vertices), fine(personal_rig(people[seed], base, targets, regions)))
        for seed in range(SAMPLED)
    }
    mean = fine(np.mean([person.vertices for person in people], axis=0))
    neutral, rig = found[f"person-{EXAGGERATED:03d}"]
    found[f"person-{EXAGGERATED:03d} x {FACTOR:g}"] = (mean + FACTOR * (neutral - mean), rig)
    return fine, found


def measure(inverse: InverseSimulation, forward: ForwardSimulation, expression: FloatArray) -> Row:
    """One unit on one head; raises AssertionError where a number is not finite."""
    head, volumes = inverse.head, inverse.shape.volumes
    state = inverse(expression)
    back = forward(state.gradients, state.bones)
    for array in (state.vertices, state.skin, state.gradients, back.vertices, back.skin, back.gradients):
        assert np.isfinite(array).all()
    assert np.isfinite(state.info.energy).all()
    seen = head.template.regions.vertices["head"]
    miss = np.linalg.norm(back.skin - expression, axis=1)[seen]
    ratio = np.linalg.det(state.gradients)
    turned = ratio <= 0
    at_bone = np.isin(head.template.tets[turned], head.template.skull).any(axis=1)
    return {
        "status": state.info.status.value,
        "status_forward": back.info.status.value,
        "iterations": state.info.iterations,
        "energy": inverse.paper_energy(state),
        "fit_rms": float(np.sqrt((miss**2).mean())),
        "fit_max": float(miss.max()),
        "back": float(np.linalg.norm(back.skin - state.skin, axis=1).max()),
        "inverted": int(turned.sum()),
        "inverted_at_skull": int(at_bone.sum()),
        "volume": float(100 * (volumes @ ratio / volumes.sum() - 1)),
        "volume_local": float(100 * (volumes @ np.abs(ratio - 1) / volumes.sum())),
    }


def solves(size: str, fine: Subdivision, people: Characters) -> Iterator[Row]:
    template = load_template(fine.faces, fine.regions(load_regions()), size)
    for name, (neutral, rig) in people.items():
        head = fit_head(template, neutral)
        inverse, forward = InverseSimulation(head), ForwardSimulation(head, ForwardSettings(collisions=False))
        for unit, moved in zip(SKIN_NAMES, rig, strict=True):
            of: Row = {"size": size, "head": name, "unit": unit}
            yield of | measure(inverse, forward, neutral + moved)
        print(f"{size} {name}: done", file=sys.stderr, flush=True)


def muscle_strains(fine: Subdivision, people: Characters) -> None:
    """Prints what the strain share of muscle does, on the first head."""
    neutral, rig = next(iter(people.values()))
    head: Head = fit_head(load_template(fine.faces, fine.regions(load_regions())), neutral)
    forward = ForwardSimulation(head, ForwardSettings(collisions=False))
    print("\n| `muscle_strain` | fit rms mm | inverted tets | iterations |\n| --- | ---: | ---: | ---: |")
    for strain in MUSCLE_STRAINS:
        inverse = InverseSimulation(head, InverseSettings(muscle_strain=strain))
        rows = pd.DataFrame([measure(inverse, forward, neutral + moved) for moved in rig])
        print("| {} | {:.4f} | {:.1f} | {:.1f} |".format(strain, *rows[["fit_rms", "inverted", "iterations"]].mean()))


def print_tables(rows: pd.DataFrame) -> None:
    for size, part in rows.groupby("size"):
        print(f"\n{size}: {len(part)} solves, inverse {part['status'].value_counts().to_dict()}", end="")
        print(f", forward {part['status_forward'].value_counts().to_dict()}")
        print(f"iterations {part['iterations'].min()} to {part['iterations'].max()}", end=", ")
        print(f"fit rms {part['fit_rms'].median():.3f}, worst {part['fit_rms'].max():.3f}", end=", ")
        print(f"largest miss {part['fit_max'].max():.2f}, to its own surface {part['back'].max():.0e} mm")
        share = part["inverted_at_skull"].sum() / max(part["inverted"].sum(), 1)
        print(f"inverted {part['inverted'].median():.0f}, worst {part['inverted'].max()}, at skull {share:.0%}")
        print(part.groupby("head", sort=False)[["fit_rms", "inverted", "energy"]].agg(["median", "max"]).round(3))
    sizes = list(dict.fromkeys(rows["size"]))
    heads = [f"{name}, {size}" for size in sizes for name, _ in COLUMNS.values()]
    print(f"\n| unit | {' | '.join(heads)} |\n| --- |{' ---: |' * len(heads)}")
    for unit in SKIN_NAMES:
        cells = []
        for size in sizes:
            part = rows[(rows["unit"] == unit) & (rows["size"] == size)]
            cells += [_cell(part[column], form) for column, (_, form) in COLUMNS.items()]
        print(f"| `{unit}` | {' | '.join(cells)} |")


def _cell(values: pd.Series[float], form: str) -> str:
    """Median and worst, which is the one furthest from 0; one number where both read the same."""
    median, worst = form.format(values.median()), form.format(max(values, key=abs))
    return median if median == worst else f"{median} / {worst}"


def main(*sizes: str) -> None:
    fine, people = characters()
    TABLE.parent.mkdir(exist_ok=True)
    rows: list[Row] = []
    for size in sizes:
        rows += solves(size, fine, people)
        pd.DataFrame(rows).to_csv(TABLE, index=False, float_format="%.4g", lineterminator="\n")
    print_tables(pd.DataFrame(rows))
    muscle_strains(fine, people)


if __name__ == "__main__":
    main(*(sys.argv[1:] or ("coarse", "paper")))
