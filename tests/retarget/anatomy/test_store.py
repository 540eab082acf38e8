"""Templates on disk: what is found, what is built again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from retarget.anatomy import store
from retarget.anatomy.__main__ import main
from retarget.anatomy.store import (
    Stored,
    content_digest,
    file_name,
    load_template,
    shipped,
    store_template,
    write_stored,
)
from retarget.anatomy.tissue import Tissue
from retarget.check import InvalidInput
from retarget.io.mesh import write_obj
from retarget.io.regions import write_regions
from retarget.types import FloatArray, IntArray, Regions
from synth_data.makehuman.author_template import levels

Head = tuple[FloatArray, IntArray, Regions]


@pytest.fixture
def unknown() -> Head:
    """A topology that no template is shipped for: the MakeHuman head with its triangles in another order."""
    skin, faces, regions = levels()[0]
    turned = np.roll(faces, 1, axis=0)
    sets = {name: np.sort((t + 1) % len(faces)) for name, t in regions.triangles.items()}
    return (
        skin,
        turned,
        Regions(regions.vertices, regions.loops, sets, regions.patches, regions.landmarks, regions.points),
    )


@pytest.fixture
def builds(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Replaces the minutes of meshing by the shipped tissue, and counts them."""
    known = shipped(file_name(levels()[0][1]))
    assert known is not None
    tissue = known.tissue
    calls: list[str] = []

    def build(skin: FloatArray, faces: IntArray, regions: Regions, depths: object, progress: object) -> Tissue:
        calls.append("built")
        return tissue

    monkeypatch.setattr(store, "build_tissue", build)
    monkeypatch.setattr(store, "muscle_tets", lambda skin, faces, regions, tissue: np.arange(len(tissue.tets)) % 2 > 0)
    return calls


def test_a_topology_is_built_once_and_found_again(tmp_path: Path, unknown: Head, builds: list[str]) -> None:
    skin, faces, regions = unknown
    with pytest.raises(InvalidInput, match=r"none is known for this topology.*python -m retarget.anatomy build"):
        load_template(faces, regions, cache=tmp_path)
    path = store_template(skin, faces, regions, cache=tmp_path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    assert store_template(skin, faces, regions, cache=tmp_path) == path
    assert builds == ["built"]
    one, two = (load_template(faces, regions, cache=tmp_path) for _ in range(2))
    for name in ("skin", "vertices", "tets", "muscle", "skull_faces", "cranium", "jaw"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    assert np.array_equal(one.embedding.data, two.embedding.data)
    assert one.regions is regions


def test_another_surface_or_depth_builds_anew(tmp_path: Path, unknown: Head, builds: list[str]) -> None:
    skin, faces, regions = unknown
    store_template(skin, faces, regions, cache=tmp_path)
    store_template(skin * 1.001, faces, regions, cache=tmp_path)
    store_template(skin * 1.001, faces, regions, {"menton": 9.0}, cache=tmp_path)
    assert len(builds) == 3
    assert load_template(faces, regions, cache=tmp_path).depths == {"menton": 9.0}


def test_a_damaged_file_is_built_again(tmp_path: Path, unknown: Head, builds: list[str]) -> None:
    skin, faces, regions = unknown
    path = store_template(skin, faces, regions, cache=tmp_path)
    whole = path.read_bytes()
    for damage in (whole[: len(whole) // 2], b"", b"no archive"):
        path.write_bytes(damage)
        with pytest.raises(InvalidInput, match="none is known"):
            load_template(faces, regions, cache=tmp_path)
    store_template(skin, faces, regions, cache=tmp_path)
    assert len(builds) == 2
    assert path.read_bytes() == whole


def test_what_is_written_is_read(tmp_path: Path, unknown: Head) -> None:
    skin, faces, regions = unknown
    tissue = Tissue(
        np.arange(15.0).reshape(5, 3),
        np.array([[0, 1, 2, 3], [1, 2, 3, 4]]),
        np.array([[0, 1, 2]]),
    )
    muscle = {"coarse": np.array([True, False]), "paper": np.arange(16) > 11}
    digest = content_digest(skin, faces, regions, {"menton": 8.0})
    write_stored(tmp_path / "a.npz", Stored(skin, tissue, muscle, {"menton": 8.0}, digest))
    found = store.read_stored(tmp_path / "a.npz")
    assert found is not None
    assert found.content == digest
    assert found.depths == {"menton": 8.0}
    for size, labels in muscle.items():
        assert np.array_equal(found.muscle[size], labels)
    for name in ("vertices", "tets", "skull_faces"):
        assert np.array_equal(getattr(found.tissue, name), getattr(tissue, name))


def test_the_digest_sees_all_that_enters(unknown: Head) -> None:
    skin, faces, regions = unknown
    depths = {"menton": 8.0}
    landmarks = {**regions.landmarks, "menton": 5}
    others = Regions(regions.vertices, regions.loops, regions.triangles, regions.patches, landmarks, regions.points)
    digests = {
        content_digest(skin, faces, regions, depths),
        content_digest(skin + 0.01, faces, regions, depths),
        content_digest(skin, faces[::-1], regions, depths),
        content_digest(skin, faces, others, depths),
        content_digest(skin, faces, regions, {"menton": 8.5}),
    }
    assert len(digests) == 5
    assert file_name(faces) != file_name(faces[::-1])


def test_the_command_builds_and_describes(
    tmp_path: Path, unknown: Head, builds: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    skin, faces, regions = unknown
    write_obj(tmp_path / "head.obj", skin, faces)
    write_regions(tmp_path / "regions.json", regions)
    arguments = ["build", str(tmp_path / "head.obj"), str(tmp_path / "regions.json"), "--cache", str(tmp_path / "kept")]
    assert main(arguments) == 0
    assert "coarse: " in capsys.readouterr().out
    assert builds == ["built"]
    assert len(list((tmp_path / "kept").iterdir())) == 1
    assert main(["build", str(tmp_path / "none.obj"), str(tmp_path / "regions.json")]) == 1
    assert "expected a mesh file, found none" in capsys.readouterr().out
