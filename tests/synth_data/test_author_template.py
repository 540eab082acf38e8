"""The template that ships is what its program makes, as far as the mesher repeats itself."""

from __future__ import annotations

import numpy as np
import pytest

from retarget.anatomy.boundary import boundary_faces, signed_volumes
from retarget.anatomy.depths import depths_with_room, landmark_depths, load_depths
from retarget.anatomy.store import content_digest, file_name, shipped
from synth_data.makehuman.author_template import author_template, levels


def test_what_ships_was_made_from_the_present_head_and_regions() -> None:
    skin, faces, regions = levels()[0]
    depths = depths_with_room(skin, faces, regions, landmark_depths(load_depths(), regions))
    tissues = []
    for v, f, r in levels():
        stored = shipped(file_name(f))
        assert stored is not None
        assert stored.content == content_digest(v, f, r, depths), "run python -m synth_data.makehuman.author_template"
        tissues.append(stored.tissue)
    assert np.array_equal(tissues[0].vertices, tissues[1].vertices)
    assert np.array_equal(tissues[0].tets, tissues[1].tets)


@pytest.mark.slow
def test_a_rebuild_is_of_the_same_kind() -> None:
    heads = levels()
    made = author_template(heads)
    name = file_name(heads[0][1])
    stored = shipped(name)
    assert stored is not None
    old, new = stored.tissue, made[name].tissue
    muscle = stored.muscle["coarse"], made[name].muscle["coarse"]
    assert made[name].content == stored.content
    assert len(new.vertices) == pytest.approx(len(old.vertices), rel=0.05)
    rims = [len(np.unique(boundary_faces(tissue.tets)[0])) for tissue in (old, new)]
    assert rims[1] == pytest.approx(rims[0], rel=0.05)
    volumes = [signed_volumes(t.vertices, t.tets) for t in (old, new)]
    assert volumes[1].sum() == pytest.approx(volumes[0].sum(), rel=2e-3)
    assert volumes[1][muscle[1]].sum() == pytest.approx(volumes[0][muscle[0]].sum(), rel=0.05)
