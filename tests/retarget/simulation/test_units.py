"""There and back on MakeHuman's head: fwdSim(invSim(X)) for every ARKit unit at full strength."""

import numpy as np
import pytest

from retarget.anatomy.head import Head
from retarget.anatomy.store import load_template
from retarget.simulation.forward import ForwardSettings, ForwardSimulation
from retarget.simulation.inverse import InverseSimulation
from retarget.types import Status
from synth_data.arkit import SKIN_NAMES
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head

FIT = {  # mm on the visible skin of the coarse template: rms and worst vertex, with a fifth of room
    "eyeBlinkLeft": (0.2, 3.0),
    "eyeBlinkRight": (0.2, 3.0),
    "mouthClose": (0.17, 1.9),
}
FIT_OF_OTHERS = 0.145, 1.25
ROUNDING = 1e-8  # mm


@pytest.fixture(scope="module")
def targets():
    return load_head()[1]


@pytest.fixture(scope="module")
def simulations():
    base, regions = load_head()[0], load_regions()
    template = load_template(base.faces, regions, "coarse")
    condyles = np.stack([regions.points[f"condyle_{side}"](template.skin) for side in ("left", "right")])
    head = Head(template, template.skin, template.vertices, condyles, {})
    return InverseSimulation(head), ForwardSimulation(head, ForwardSettings(collisions=False))


@pytest.mark.parametrize("unit", SKIN_NAMES)
def test_a_unit_comes_back(simulations, targets, unit):
    inverse, forward = simulations
    expression = inverse.head.skin + targets[f"units/{unit}"]
    state = inverse(expression)
    back = forward(state.gradients, state.bones)
    assert state.info.status is Status.CONVERGED is back.info.status
    assert np.isfinite(state.gradients).all()
    np.testing.assert_allclose(back.skin, state.skin, atol=ROUNDING)
    np.testing.assert_allclose(back.vertices, state.vertices, atol=ROUNDING)
    visible = inverse.head.template.regions.vertices["head"]
    miss = np.linalg.norm(back.skin - expression, axis=1)[visible]
    rms, worst = FIT.get(unit, FIT_OF_OTHERS)
    assert np.sqrt((miss**2).mean()) < rms
    assert miss.max() < worst
