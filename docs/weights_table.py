"""The table of docs/simulation.md on the weights of facial characteristics: `python docs/weights_table.py`."""

from __future__ import annotations

import numpy as np

from retarget.anatomy.fit import fit_head
from retarget.anatomy.store import load_template
from retarget.geometry.triangles import areas
from retarget.simulation.bones import size_ratio
from retarget.simulation.characteristics import EYE_OPENINGS, EYE_SOCKETS, FacialCharacteristics
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSimulation
from retarget.types import FloatArray, Pair
from synth_data.makehuman.identities import IdentitySampler
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.subdivide import subdivide
from synth_data.makehuman.targets import load_head

WEIGHTS = ((0, 0), (10, 10), (100, 100), (1000, 1000), (10000, 10000))  # of eyes and of the lip contour


def main() -> None:
    """A blink and a smile of one sampled person on the head of another, coarse template."""
    base, targets = load_head()
    fine = subdivide(base.faces, len(base.vertices))
    regions = fine.regions(load_regions())
    sample = IdentitySampler(base, targets, load_regions())
    template = load_template(fine.faces, regions, "coarse")
    source, target = (fit_head(template, fine(sample(seed).vertices)) for seed in (0, 1))
    characteristics = FacialCharacteristics(Pair(fine.faces, source.skin, target.skin, regions))
    inverse, scale = InverseSimulation(source), size_ratio(source.skin, target.skin)

    def shown(unit: str) -> FloatArray:
        return source.skin + fine(targets[f"units/{unit}Left"] + targets[f"units/{unit}Right"])

    print("| weight of eyes, lips | eye openings | eye sockets | lip contour |\n| --- | ---: | ---: | ---: |")
    for eyes, lips in WEIGHTS:
        settings = ForwardSettings(w_lip_contour=lips, w_eye_opening=eyes, w_eye_socket=eyes, collisions=False)
        forward = ForwardSimulation(target, settings)
        missed = []
        for unit in ("eyeBlink", "mouthSmile"):
            formed, wanted = inverse(shown(unit)), characteristics(shown(unit))
            skin = forward(formed.gradients, formed.bones, scale, wanted).skin
            for names, ratios in ((EYE_OPENINGS, wanted.eye_opening), (EYE_SOCKETS, wanted.eye_socket)):
                patch = np.concatenate([regions.patches[name] for name in names])
                assert ratios is not None
                missed.append(np.abs(areas(skin, patch) / areas(target.skin, patch) - ratios).mean())
            assert wanted.lip_contour is not None
            missed.append(np.linalg.norm(skin[regions.loops["lip_contour"]] - wanted.lip_contour, axis=1).mean())
        print(f"| {eyes}, {lips} | {missed[0]:.3f} | {missed[1]:.3f} | {missed[5]:.2f} |")


if __name__ == "__main__":
    main()
