"""What docs/personal_expressions.md reports: `python -m synth_data.personal.measure [people]`."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping

import numpy as np

from retarget.anatomy.closed import self_intersections
from retarget.types import FloatArray, IntArray, Regions
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.anthropometry import personalisation
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import Subdivision, subdivide
from synth_data.makehuman.targets import load_head
from synth_data.personal.face import PersonalFace, personal_face
from synth_data.personal.scans import Scan, personal_scans, unit_weights
from synth_data.personal.traits import draw_traits
from synth_data.weights import blending_weights

FRAMES = 60  # recombined expressions in which crossings are counted, besides the neutral and the scans


def magnitudes(face: PersonalFace, regions: Regions) -> dict[str, float]:
    """Distances and angles of full expressions, by name, in mm, degrees or percent."""
    marks = regions.landmarks
    corners = [marks["cheilion_left"], marks["cheilion_right"]]

    def posed(**units: float) -> FloatArray:
        return np.asarray(face(unit_weights(units))[0])

    def width(v: FloatArray) -> float:
        return float(np.linalg.norm(v[corners[0]] - v[corners[1]]))

    def lips(v: FloatArray) -> float:
        return float(np.linalg.norm(v[marks["stomion_upper"]] - v[marks["stomion_lower"]]))

    smile, open_, rest = posed(mouthSmile=1), posed(jawOpen=1), face.neutral
    corner = np.mean(
        [face.frame.local(smile[c] - rest[c]) * (s, 1, 1) for c, s in zip(corners, (1, -1), strict=True)], 0
    )
    excursions = {
        name: float(np.linalg.norm(posed(**{unit: 1.0})[marks["pogonion"]] - rest[marks["pogonion"]]))
        for name, unit in {
            "protrusion": "jawForward",
            "jaw to the left": "jawLeft",
            "jaw to the right": "jawRight",
        }.items()
    }
    return {
        "lip opening under jawOpen (mm)": lips(open_) - lips(rest),
        "incisal opening under jawOpen (mm)": 2 * face.jaw.length * float(np.sin(face.jaw.angle / 2)),
        "length from condyles to incisors (mm)": face.jaw.length,
        "smile: mouth wider (%)": 100 * (width(smile) / width(rest) - 1),
        "smile: corner's direction (degrees)": float(np.degrees(np.arctan2(corner[1], corner[0]))),
        "smile: corner's path (mm)": float(np.linalg.norm(corner)),
        "pucker: mouth narrower (%)": 100 * (1 - width(posed(mouthPucker=1)) / width(rest)),
        **{f"{name} (mm)": value for name, value in excursions.items()},
    }


def span_residual(scans: list[Scan], neutral: FloatArray, rig: FloatArray, region: IntArray) -> tuple[float, float]:
    """RMS residual in mm of the scans' displacements in the span of a rig (51, n, 3), and its share of the motion."""
    basis = rig[:, region].reshape(len(rig), -1).T
    motion = np.stack([(scan.vertices - neutral)[region].ravel() for scan in scans], axis=1)
    residual = motion - basis @ np.linalg.lstsq(basis, motion, rcond=None)[0]
    count = len(region) * len(scans)
    return float(np.sqrt((residual**2).sum() / count)), float(np.sqrt((residual**2).sum() / (motion**2).sum()))


def crossings(face: PersonalFace, frames: Mapping[str, FloatArray], fine: Subdivision) -> dict[str, int]:
    """Pairs of triangles that cross in frames (n, 3) mm by name, on the base mesh and refined, where there are any."""
    found = {}
    for name, frame in frames.items():
        found[name] = len(self_intersections(frame, face.faces))
        found[f"{name}, refined"] = len(self_intersections(fine(frame), fine.faces))
    return {name: count for name, count in found.items() if count}


def nonadditive(face: PersonalFace, region: IntArray) -> float:
    """Share of the motion of pairs of units that the sum of both alone misses, RMS over a list of usual pairs."""
    pairs = (
        ("jawOpen", "mouthSmile"),
        ("mouthSmile", "cheekSquint"),
        ("mouthPucker", "jawOpen"),
        ("mouthFrown", "jawOpen"),
    )
    missed = total = 0.0
    for pair in pairs:
        both, one, other = (
            face(unit_weights(dict.fromkeys(names, 1.0)))[0][region] - face.neutral[region]
            for names in (pair, pair[:1], pair[1:])
        )
        missed += float(np.sum((both - one - other) ** 2))
        total += float(np.sum(both**2))
    return float(np.sqrt(missed / total))


def main(people: str = "8") -> None:
    head, targets = load_head(progress=print)
    regions = load_regions()
    sampler = IdentitySampler(head, targets, regions)
    rig = np.stack([targets[f"units/{name}"] for name in SKIN_NAMES])
    region = regions.vertices["head"]
    fine, blended = subdivide(head.faces, len(head.vertices), 1), blending_weights("recombined", FRAMES)
    measured, motions, residuals, own = [], [], [], []
    for seed in range(int(people)):
        identity = sampler(seed)
        face = personal_face(identity.vertices, head.faces, regions, draw_traits(seed, identity.age))
        scans = list(personal_scans(face))
        motions.append(np.stack([scan.vertices - face.neutral for scan in scans]))
        residuals.append(span_residual(scans, face.neutral, rig, region))
        units = face(np.eye(len(SKIN_NAMES))) - face.neutral
        own.append((*span_residual(scans, face.neutral, units, region), nonadditive(face, region)))
        measured.append(magnitudes(face, regions))
        frames = {"neutral": face.neutral, **{scan.name: scan.vertices for scan in scans}}
        frames |= {f"recombined-{i:03d}": frame for i, frame in enumerate(face(blended))}
        crossing = crossings(face, frames, fine) or "none"
        print(f"seed {seed}: pairs of triangles that cross in {len(frames)} frames: {crossing}", flush=True)
    print("\n| measure | mean | deviation | least | most |\n| --- | --- | --- | --- | --- |")
    for name in measured[0]:
        values = np.array([row[name] for row in measured])
        print(f"| {name} | {values.mean():.1f} | {values.std(ddof=1):.1f} | {values.min():.1f} | {values.max():.1f} |")
    shares = [personalisation(a, b, region) for a, b in itertools.combinations(motions, 2)]
    apart = [np.sqrt(np.mean(np.sum((a - b)[:, region] ** 2, axis=2))) for a, b in itertools.combinations(motions, 2)]
    low, high = np.quantile(shares, [0.1, 0.9])
    share = f"{np.mean(shares):.0%} of the motion (80 % of pairs: {low:.0%} to {high:.0%})"
    print(f"\nScans of two people differ by {share}, {np.mean(apart):.2f} mm RMS over the head.")
    smiles = [m[1] for m in motions]
    lips = regions.vertices["lips"]
    differ = [np.sqrt(np.mean(np.sum((a - b)[lips] ** 2, axis=1))) for a, b in itertools.combinations(smiles, 2)]
    print(f"Smiles of two people differ by {np.mean(differ):.1f} mm RMS on the lips.")
    r, o = np.mean(residuals, axis=0), np.mean(own, axis=0)
    print(f"Outside the span of the generic units: {r[0]:.2f} mm RMS, {r[1]:.0%} of the motion.")
    print(
        f"Outside the span of the person's own units at weight 1: {o[0]:.2f} mm, {o[1]:.0%}. Non-additive: {o[2]:.0%}."
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
