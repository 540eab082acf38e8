"""The command line of the own topology, on MakeHuman's head saved in cm beside an eyeball."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from experiments.topology import main
from retarget.anatomy.landmarks import LANDMARKS
from retarget.io.mesh import read_mesh, write_obj
from retarget.io.regions import read_regions
from synth_data.makehuman.regions import load_regions
from synth_data.makehuman.targets import load_head


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The head in cm after an eyeball, and its landmarks in the numbers of that file; the picture is left out."""
    base, _ = load_head()
    ball = trimesh.creation.icosphere(2, radius=12.0)
    centre = base.vertices[load_regions().vertices["eye_left"]].mean(axis=0) - np.array([0.0, 0.0, 10.0])
    vertices = np.vstack([ball.vertices + centre, base.vertices]) / 10
    write_obj(tmp_path / "head.obj", vertices, np.vstack([ball.faces, base.faces + len(ball.vertices)]))
    picked = {name: load_regions().landmarks[name] + len(ball.vertices) for name in LANDMARKS}
    (tmp_path / "landmarks.json").write_text(json.dumps({"unit": "cm", "landmarks": picked}))
    monkeypatch.setattr("reports.regions_sheet.regions_sheet", lambda path, *head: Path(path).write_bytes(b""))
    return tmp_path


def test_transfer_writes_what_the_builder_reads(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["transfer", str(folder / "head.obj"), str(folder / "landmarks.json"), "-o", str(folder / "out")])
    assert {path.name for path in (folder / "out").iterdir()} == {"skin.obj", "open.obj", "regions.json", "check.png"}
    base, _ = load_head()
    vertices, faces = read_mesh(folder / "out" / "skin.obj")
    np.testing.assert_allclose(vertices, base.vertices, atol=1e-4)
    np.testing.assert_array_equal(faces, base.faces)
    regions = read_regions(folder / "out" / "regions.json", len(vertices), faces)
    assert set(regions.loops) == set(load_regions().loops)
    assert "lips apart" in capsys.readouterr().out

    main(["skin", str(folder / "head.obj"), str(folder / "landmarks.json"), "-o", str(folder / "again.obj")])
    assert (folder / "again.obj").read_text() == (folder / "out" / "skin.obj").read_text()

    path = folder / "out" / "regions.json"
    path.write_text(path.read_text().replace('"nasion":', '"nose_root":'))
    main(["check", str(folder / "out")])
    path.write_text(path.read_text().replace('"loops": {', '"loops": {\n"torn":[1,2,900],'))
    with pytest.raises(SystemExit):
        main(["check", str(folder / "out")])
    assert "loops['torn'] is no closed chain of edges" in capsys.readouterr().err


def test_a_wrong_unit_is_told_without_a_traceback(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = folder / "landmarks.json"
    path.write_text(path.read_text().replace('"cm"', '"mm"'))
    with pytest.raises(SystemExit):
        main(["transfer", str(folder / "head.obj"), str(path), "-o", str(folder / "out")])
    assert "It looks like cm: multiply by 10" in capsys.readouterr().err
    assert not (folder / "out").exists()
