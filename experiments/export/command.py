"""The command: choose what, make it, write it in the chosen format."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from omegaconf import DictConfig
from rich.console import Console

from experiments.export.retargeted import retargeted
from experiments.export.scene import Free, Scene, rig, truth
from experiments.progress import Advance, print_line, print_path, progress
from retarget.check import InvalidInput, check_whole
from retarget.io.files import check_folder, write_whole_folder
from retarget.io.gltf import write_glb
from retarget.io.npz import write_npz
from retarget.io.obj_sequence import write_obj_sequence
from retarget.suggest import choose

FOLDER = Path("exports")  # below the current folder
INFO = "export.json"  # what a folder of an export holds besides its meshes

KINDS: dict[str, Callable[[DictConfig, Console, Free], Scene]] = {"truth": truth, "rig": rig, "retargeted": retargeted}


def export(config: DictConfig, console: Console) -> Path:
    """The main job; returns the path of the file or folder. Raises InvalidInput with what to do."""
    choose("what", str(config.what), KINDS)
    choose("format", str(config.format), WRITERS)
    _check_settings(config)
    if config.output is not None:  # before anything that takes long
        _check_free(_output(config), config.overwrite)
    started = time.perf_counter()

    def free(stem: str, meshes: int) -> Path:
        path = _output(config, stem, meshes)
        _check_free(path, config.overwrite)
        return path

    scene = KINDS[config.what](config, console, free)
    path = free(scene.stem, len(scene.meshes))
    with progress(console, f"writing {config.format}", sum(len(mesh.shapes) for mesh in scene.meshes)) as advance:
        WRITERS[config.format](path, scene, config, advance)
    first, names = scene.meshes[0], ", ".join(mesh.name for mesh in scene.meshes)
    line = (
        f"{names}: {len(first.neutral):,} vertices, {len(first.shapes)} shapes, {len(first.times)} key frames in "
        f"{first.times[-1]:.1f} s; {_size(path) / 1e6:.1f} MB, done in {time.perf_counter() - started:.0f} s"
    )
    print_line(line, console)
    for note in dict.fromkeys(str(mesh.about["note"]) for mesh in scene.meshes if "note" in mesh.about):
        print_line(note, console)
    print_path(path, console)
    return path


def _check_settings(config: DictConfig) -> None:
    for name in ("normals", "overwrite"):
        if not isinstance(config[name], bool):
            raise InvalidInput(f"{name}: expected true or false, got {config[name]!r}.")
    for name in ("output", "from"):
        if not isinstance(config[name], str | None):
            raise InvalidInput(f"{name}: expected a path or null, got {config[name]!r}.")
    check_whole("most_targets", config.most_targets, 1)
    for name in ("fps", "seconds"):
        value = config[name]
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value is not None and not (number and 0 < value < np.inf):
            raise InvalidInput(f"{name}: expected a positive number or null, got {value!r}.")
    if config.seconds is not None and config.take is None:
        raise InvalidInput("seconds: cuts a take, but there is none; choose expressions with frames=0:50.")
    if config["from"] is not None and (config.what != "retargeted" or config.take is not None):
        raise InvalidInput("from: a study stores retargeted expressions; add what=retargeted and leave out the take.")


def _output(config: DictConfig, stem: str = "", meshes: int | None = None) -> Path:
    """Absolute; `stem` names it where the user does not."""
    if config.output is None:
        single = config.format != "obj" and (config.format == "glb" or meshes == 1)
        return (FOLDER / (f"{stem}.{config.format}" if single else f"{stem}-{config.format}")).absolute()
    path = Path(config.output).expanduser().absolute()
    suffixes = {"glb": (".glb",), "npz": (".npz", ""), "obj": ("",)}[config.format]
    if path.suffix.lower() not in suffixes:
        expected = {"glb": "a path that ends in .glb", "npz": "a path that ends in .npz", "obj": "a folder"}
        raise InvalidInput(f"output: expected {expected[config.format]}, got {config.output}.")
    if config.format == "npz" and meshes is not None and (meshes == 1) != (path.suffix != ""):
        wanted = "a folder, for a file of each identity" if meshes > 1 else "a path that ends in .npz"
        raise InvalidInput(f"output: expected {wanted}, got {config.output}.")
    return path


def _check_free(path: Path, overwrite: bool) -> None:
    """Raises InvalidInput where nothing can be written, or something is that may not be replaced."""
    if path.exists() and not overwrite:
        raise InvalidInput(
            f"{path}: is there already. Add overwrite=true to replace it, or choose another output=PATH."
        )
    if path.is_dir() and not (path.suffix == "" and (path / INFO).is_file()):
        raise InvalidInput(
            f"{path}: is a folder that no export has written (there is no {INFO} in it), and is left alone; choose "
            "another output=PATH."
        )
    check_folder(path.parent, "output=PATH")


def _glb(path: Path, scene: Scene, config: DictConfig, advance: Advance) -> None:
    write_glb(path, scene.faces, scene.meshes, {**scene.about, "unit": "m"}, config.normals, advance)


def _npz(path: Path, scene: Scene, config: DictConfig, advance: Advance) -> None:
    def write(file: Path, index: int) -> None:
        mesh = scene.meshes[index]
        about = {**scene.about, "unit": "mm", **mesh.about}
        write_npz(file, scene.faces, replace(mesh, about=about))
        advance(len(mesh.shapes))

    def write_all(folder: Path) -> None:
        for index, mesh in enumerate(scene.meshes):
            write(folder / f"{mesh.name}.npz", index)
        _write_info(folder, scene)

    if path.suffix:
        write(path, 0)
    else:
        write_whole_folder(path, write_all)


def _obj(path: Path, scene: Scene, config: DictConfig, advance: Advance) -> None:
    def write_all(folder: Path) -> None:
        for mesh in scene.meshes:
            write_obj_sequence(folder / mesh.name, scene.faces, mesh, advance)
        _write_info(folder, scene)

    write_whole_folder(path, write_all)


def _write_info(folder: Path, scene: Scene) -> None:
    meshes = {
        mesh.name: {**mesh.about, "shapes": list(mesh.shape_names), "times": mesh.times.tolist()}
        for mesh in scene.meshes
    }
    text = json.dumps({**scene.about, "unit": "mm", "meshes": meshes}, indent=1, ensure_ascii=False)
    (folder / INFO).write_text(text + "\n", encoding="utf-8")


WRITERS: dict[str, Callable[[Path, Scene, DictConfig, Advance], None]] = {"glb": _glb, "obj": _obj, "npz": _npz}


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
