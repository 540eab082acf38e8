"""What is exported: identities of a dataset performing its truth, or their rigs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig
from rich.console import Console

from experiments.export.motion import Motion, in_turn, rigged, taken
from experiments.progress import progress
from retarget.check import InvalidInput
from retarget.io.morph_mesh import MorphMesh, flipbook
from retarget.types import IntArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.dataset import Dataset

COMPARED = 20  # frames on which a rig is compared with its truth
LINEAR = 1e-3  # mm by which a linear truth and its blended units may differ


@dataclass(frozen=True)
class Scene:
    """Meshes of one topology."""

    stem: str  # of the file's name, unless the user gives one
    faces: IntArray  # (f, 3)
    meshes: tuple[MorphMesh, ...]
    about: Mapping[str, Any]  # plain data


def truth(config: DictConfig, console: Console) -> Scene:
    """Identities performing expressions or a take; each frame is a shape."""
    dataset = load_dataset(config, console)
    names, motion = _identities(config, dataset), chosen_motion(config, dataset)
    check_targets(motion.count, config)
    meshes = []
    with progress(console, "performing", len(names)) as advance:
        for name in names:
            frames = motion.performed(dataset, name).astype(np.float32)
            meshes.append(flipbook(name, dataset.neutral(name), frames, motion.names, motion.times))
            advance(1)
    stem = f"truth-{dataset.conditions.truth}-{_stem(names)}"
    return Scene(stem, dataset.faces, tuple(meshes), about_data(config, dataset))


def rig(config: DictConfig, console: Console) -> Scene:
    """The face units of identities as shapes, animated by the weights of expressions or a take."""
    dataset = load_dataset(config, console)
    rigged(dataset)
    names, motion = _identities(config, dataset), chosen_motion(config, dataset)
    meshes = []
    with progress(console, "performing units", len(names)) as advance:
        for name in names:
            meshes.append(_rig_of(dataset, name, motion))
            advance(1)
    stem = f"rig-{dataset.conditions.truth}-{_stem(names)}"
    return Scene(stem, dataset.faces, tuple(meshes), about_data(config, dataset))


def _rig_of(dataset: Dataset, name: str, motion: Motion) -> MorphMesh:
    """All 52 units at weight 1, because receivers look them up by name; `tongueOut` moves no skin: the neutral."""
    if motion.weights is None:
        raise InvalidInput(
            f"dataset {dataset.conditions.dataset}: expected weights of the {len(SKIN_NAMES)} face units."
        )
    neutral = dataset.neutral(name)
    shapes = np.repeat(neutral[None], len(NAMES), axis=0)
    shapes[[NAMES.index(unit) for unit in SKIN_NAMES]] = rigged(dataset).perform(name, np.eye(len(SKIN_NAMES)))
    rig = MorphMesh(name, neutral, shapes, NAMES, motion.times, motion.weights)
    shown = np.unique(np.linspace(0, motion.count - 1, COMPARED).astype(int))
    performed = motion.only(shown).performed(dataset, name)
    errors = np.array([np.linalg.norm(rig.at(k) - frame, axis=1) for k, frame in zip(shown, performed, strict=True)])
    linear = bool(errors.max() < LINEAR)
    note = (
        "Morph targets are the deltas of this linear truth; blended, they are the truth."
        if linear
        else "Morph targets are the truth's frames of single units at weight 1. The truth is not linear: blended, they "
        f"differ from it by up to {errors.max():.2g} mm ({errors.mean():.2g} mm on average) on {len(shown)} frames."
    )
    about = {"note": f"{note} tongueOut moves no skin: its target is zero.", "linear": linear}
    return replace(rig, shapes=shapes.astype(np.float32), about=about)


def load_dataset(config: DictConfig, console: Console) -> Dataset:
    dataset: Dataset = instantiate(config.dataset).load(lambda line: console.print(f"  {line}"))
    return dataset


def chosen_motion(config: DictConfig, dataset: Dataset) -> Motion:
    """What `take`, `frames`, `seconds` and `fps` ask for."""
    if config.take is None:
        return in_turn(dataset, config.frames, config.fps)
    rigged(dataset)
    return taken(str(config.take), config.frames, config.fps, config.seconds)


def check_targets(count: int, config: DictConfig) -> None:
    """Raises InvalidInput for an animation of more frames than a glTF should have morph targets."""
    if config.format == "glb" and count > config.most_targets:
        raise InvalidInput(
            f"frames: {count} frames, each a morph target, are more than most_targets={config.most_targets}; 256 is "
            f"what every device with WebGL 2 holds. Choose fewer, such as frames=0:{config.most_targets} or frames=::"
            f"{-(-count // config.most_targets)}; or what=rig, whose takes may have any length; or format=npz or "
            "format=obj; or raise most_targets for a tool that you know."
        )


def about_data(config: DictConfig, dataset: Dataset) -> dict[str, Any]:
    """What the meshes are conditional on."""
    take = {} if config.take is None else {"take": str(config.take)}
    return {"what": config.what, **asdict(dataset.conditions), **take, "fingerprint": dataset.fingerprint}


def _identities(config: DictConfig, dataset: Dataset) -> tuple[str, ...]:
    if config.identity is None:
        return dataset.identities[:1]
    if config.identity == "all":
        return dataset.identities
    listed = [config.identity] if isinstance(config.identity, str) else list(config.identity)
    names = tuple(dataset.known(str(name)) for name in listed)
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"identity: expected one or more, each once, or all; got {listed}.")
    return names


def _stem(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{len(names)}-identities"
