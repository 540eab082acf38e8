"""What is exported: identities of a dataset performing its truth, or their rigs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeVar

import numpy as np
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig
from rich.console import Console

from experiments.export.motion import Motion, in_turn, rigged, select, taken
from experiments.progress import print_line, progress
from retarget.check import InvalidInput
from retarget.io.morph_mesh import MorphMesh, flipbook
from retarget.suggest import choose
from retarget.types import IntArray
from synth_data.arkit import NAMES, SKIN_NAMES
from synth_data.dataset import Dataset
from synth_data.performed import PerformedConfig

COMPARED = 20  # frames on which a rig is compared with its truth
LINEAR = 1e-3  # mm by which a linear truth and its blended units may differ


@dataclass(frozen=True)
class Scene:
    """Meshes of one topology."""

    stem: str  # of the file's name, unless the user gives one
    faces: IntArray  # (f, 3)
    meshes: tuple[MorphMesh, ...]
    about: Mapping[str, Any]  # plain data


@dataclass(frozen=True)
class Known:
    """What there is to choose from; most datasets know it before anybody is made."""

    truth: str
    identities: tuple[str, ...]
    expressions: tuple[str, ...]


Free = Callable[[str, int], object]  # given a scene's stem and count of meshes, raises where it may not be written
Checked = TypeVar("Checked")


def truth(config: DictConfig, console: Console, free: Free) -> Scene:
    """Identities performing expressions or a take; each frame is a shape."""
    dataset, names, motion, stem = _chosen(config, console, free)
    meshes = []
    with progress(console, "performing", len(names)) as advance:
        for name in names:
            frames = motion.performed(dataset, name).astype(np.float32)
            meshes.append(flipbook(name, dataset.neutral(name), frames, motion.names, motion.times))
            advance(1)
    return Scene(stem, dataset.faces, tuple(meshes), about_data(config, dataset, motion))


def rig(config: DictConfig, console: Console, free: Free) -> Scene:
    """The face units of identities as shapes, animated by the weights of expressions or a take."""
    dataset, names, motion, stem = _chosen(config, console, free)
    meshes = []
    with progress(console, "performing units", len(names)) as advance:
        for name in names:
            meshes.append(_rig_of(dataset, name, motion))
            advance(1)
    return Scene(stem, dataset.faces, tuple(meshes), about_data(config, dataset, motion))


def _chosen(config: DictConfig, console: Console, free: Free) -> tuple[Dataset, tuple[str, ...], Motion, str]:
    """The dataset, who performs what, and the stem."""
    take = chosen_take(config, console)

    def check(known: Known) -> tuple[tuple[str, ...], str]:
        names = _identities(config, known)
        count = chosen_count(config, take, known)
        if config.what == "truth":
            check_targets(count, config)
        stem = f"{config.what}-{known.truth}-{names[0] if len(names) == 1 else f'{len(names)}-identities'}"
        free(stem, len(names))
        return names, stem

    dataset, (names, stem) = load_dataset(config, console, check)
    return dataset, names, take or in_turn(dataset, config.frames, config.fps), stem


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


def load_dataset(config: DictConfig, console: Console, check: Callable[[Known], Checked]) -> tuple[Dataset, Checked]:
    """The dataset, and what `check` makes of its names: it raises before people are made, where names are known."""
    settings = instantiate(config.dataset)
    checked = None
    if isinstance(settings, PerformedConfig):
        settings.check()
        checked = check(Known(settings.truth, tuple(settings.seeds()), settings.expression_names()))
    dataset: Dataset = settings.load(lambda line: print_line(f"  {line}", console))
    if config.what == "rig" or config.take is not None:
        rigged(dataset)
    return dataset, checked or check(Known(dataset.conditions.truth, dataset.identities, dataset.expressions))


def chosen_take(config: DictConfig, console: Console) -> Motion | None:
    """What `take`, `frames`, `seconds` and `fps` ask for; None for the expressions of the dataset."""
    if config.take is None:
        return None
    take = taken(str(config.take), config.frames, config.fps, config.seconds)
    if take.recording is not None:
        print_line(f"  take {take.recording}", console)
    return take


def chosen_count(config: DictConfig, take: Motion | None, known: Known) -> int:
    """Frames of the take, or of the dataset's expressions. Raises InvalidInput for frames that there are not."""
    return len(select(config.frames, known.expressions)) if take is None else take.count


def check_targets(count: int, config: DictConfig) -> None:
    """Raises InvalidInput for an animation of more frames than a glTF should have morph targets."""
    if config.format == "glb" and count > config.most_targets:
        raise InvalidInput(
            f"frames: {count} frames, each a morph target, are more than most_targets={config.most_targets}; 256 is "
            f"what every device with WebGL 2 holds. Choose fewer, such as frames=0:{config.most_targets} or frames=::"
            f"{-(-count // config.most_targets)}; or what=rig, whose takes may have any length; or format=npz or "
            "format=obj; or raise most_targets for a tool that you know."
        )


def about_data(config: DictConfig, dataset: Dataset, motion: Motion) -> dict[str, Any]:
    """What the meshes are conditional on."""
    take = {} if config.take is None else {"take": str(config.take)}
    if motion.recording is not None:
        take["recording"] = motion.recording
    return {"what": config.what, **asdict(dataset.conditions), **take, "fingerprint": dataset.fingerprint}


def _identities(config: DictConfig, known: Known) -> tuple[str, ...]:
    if config.identity is None:
        return known.identities[:1]
    if config.identity == "all":
        return known.identities
    listed = list(config.identity) if isinstance(config.identity, ListConfig) else [config.identity]
    names = tuple(choose("identity", str(name), known.identities) for name in listed)
    if not names or len(set(names)) < len(names):
        raise InvalidInput(f"identity: expected one or more, each once, or all; got {listed}.")
    return names
