"""What lies in the folder: who performs what, in which file."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from retarget.check import InvalidInput
from retarget.suggest import choose

SUFFIXES = (".obj", ".ply", ".npz")
RESTING = ("neutral", "rest", "relaxed")  # words in the name of a neutral, the surest first
LAYOUT = "docs/own_scans.md shows the layout: a folder for each person, a mesh for each expression."

Files = Mapping[str, Path]  # by expression, the neutral among them


@dataclass(frozen=True)
class Listing:
    """A folder of people who perform the same expressions."""

    files: Mapping[str, Files]  # by identity: the neutral and `expressions`, nothing else
    neutral: str
    expressions: tuple[str, ...]  # of every identity, sorted, without the neutral
    lacking: Mapping[str, tuple[str, ...]]  # identity -> expressions of others that it has no file for
    passed_over: Mapping[str, str]  # folder -> why it is no person

    @property
    def identities(self) -> tuple[str, ...]:
        return tuple(self.files)


def list_folder(root: Path, neutral: str | None, identities: int | Sequence[str] | None) -> Listing:
    """List `root`. neutral: its name, or None to find it; identities: how many or which, or None for all.

    Hidden files and all that is no mesh are passed over. Raises InvalidInput for a folder that no study can use.
    """
    if not root.is_dir():
        raise InvalidInput(f"dataset.root: expected a folder of meshes, found none at {root}; check the path. {LAYOUT}")
    found = {folder.name: _meshes(folder) for folder in _visible(root) if folder.is_dir()}
    passed_over = {name: "holds no mesh" for name, files in found.items() if not files}
    found = {name: files for name, files in found.items() if files}
    if identities is None or isinstance(identities, int):
        linked = _linked(found)
        passed_over |= {name: f"is the same folder as {other}" for name, other in linked.items()}
        found = {name: files for name, files in found.items() if name not in linked}
    found = _chosen(found, identities)
    if len(found) < 2:
        loose = sum(path.suffix.lower() in SUFFIXES for path in _visible(root))
        raise InvalidInput(
            f"dataset.root: expected meshes ({', '.join(SUFFIXES)}) of at least two people in {root}, because one "
            f"performs and the other retargets; got {', '.join(found) or 'none'}"
            + "".join(f", and {name} {why}" for name, why in passed_over.items())
            + (f", and {loose} meshes that lie in no person's folder" if loose else "")
            + f". {LAYOUT}"
        )
    _check_spelling(found)
    rest = _resting(found, neutral)
    shared = set.intersection(*(set(files) for files in found.values())) - {rest}
    everything = set.union(*(set(files) for files in found.values()))
    if not shared:
        raise InvalidInput(
            f"dataset.root: no expression has a mesh for each of {', '.join(found)}, expected the same names in every "
            f"folder. {next(iter(found))} has {', '.join(sorted(next(iter(found.values()))))}."
        )
    return Listing(
        files={name: {key: files[key] for key in (rest, *sorted(shared))} for name, files in found.items()},
        neutral=rest,
        expressions=tuple(sorted(shared)),
        lacking={name: tuple(sorted(everything - set(files))) for name, files in found.items()},
        passed_over=passed_over,
    )


def _visible(folder: Path) -> Iterator[Path]:
    try:
        yield from sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError as error:
        raise InvalidInput(f"{folder}: cannot be read ({error.strerror or error}); make it readable.") from error


def _meshes(folder: Path) -> dict[str, Path]:
    """The mesh of each expression. Raises InvalidInput where one has two, or for a pipe, which never ends."""
    meshes: dict[str, Path] = {}
    for path in _visible(folder):
        if path.suffix.lower() in SUFFIXES and not path.is_dir():
            if path.exists() and not path.is_file():
                raise InvalidInput(f"{path}: expected a mesh file, found a pipe, socket or device; remove it.")
            if path.stem in meshes:
                raise InvalidInput(
                    f"{folder}: {meshes[path.stem].name} and {path.name} are the same expression twice, expected one "
                    "mesh for each; remove one."
                )
            meshes[path.stem] = path
    return meshes


def _folder(files: Files) -> Path:
    """Of one person."""
    return next(iter(files.values())).parent


def _linked(found: Mapping[str, Files]) -> dict[str, str]:
    """Each link to another's folder -> the name of that folder; of links alone the first counts as the folder."""
    names: dict[Path, str] = {}
    for name in sorted(found, key=lambda name: (_folder(found[name]).is_symlink(), name)):
        names.setdefault(_folder(found[name]).resolve(), name)
    named = {name: names[_folder(files).resolve()] for name, files in found.items()}
    return {name: other for name, other in named.items() if other != name}


def _chosen(found: dict[str, dict[str, Path]], wanted: int | Sequence[str] | None) -> dict[str, dict[str, Path]]:
    if wanted is None:
        return found
    if isinstance(wanted, int) and not isinstance(wanted, bool) and wanted > 0:
        if wanted > len(found):
            raise InvalidInput(f"dataset.identities: {wanted} asked for, but the folder holds {len(found)}.")
        return dict(list(found.items())[:wanted])
    if isinstance(wanted, Iterable) and not isinstance(wanted, str):
        names = [choose("dataset.identities", str(name), found) for name in wanted]
        chosen = {name: found[name] for name in names}
        if len(names) > len(chosen) or _linked(chosen):
            twice = [f"{name} is {other}" for name, other in _linked(chosen).items()] or names
            raise InvalidInput(f"dataset.identities: expected each person once, got {', '.join(twice)}; remove one.")
        return chosen
    raise InvalidInput(f"dataset.identities: expected null, a number from 2 on or a list of folders, got {wanted!r}.")


def _check_spelling(found: Mapping[str, Files]) -> None:
    """Raises InvalidInput for names that differ only in capitals, or in how an accent is stored."""
    spellings: dict[str, dict[str, list[str]]] = {}
    for identity, files in found.items():
        for name in files:
            folded = unicodedata.normalize("NFC", name).casefold()
            spellings.setdefault(folded, {}).setdefault(name, []).append(identity)
    for names in spellings.values():
        if len(names) > 1:
            where = " and ".join(f"'{name}' ({', '.join(people)})" for name, people in names.items())
            raise InvalidInput(
                f"dataset.root: {where} differ only in capitals or accents, expected one spelling of an expression in "
                "every folder; rename the files."
            )


def _resting(found: Mapping[str, Files], neutral: str | None) -> str:
    """The name of the neutral, which every identity has."""
    if neutral is None:
        return _guessed(found)
    everyone = sorted(set.union(*(set(files) for files in found.values())))
    choose("dataset.neutral", neutral, everyone)
    if lacking := [str(_folder(files)) for files in found.values() if neutral not in files]:
        raise InvalidInput(
            f"dataset.root: no neutral '{neutral}' in {', '.join(lacking)}, expected one in every folder. Add the mesh "
            "of the face at rest, leave these people out with dataset.identities, or name another mesh with "
            "dataset.neutral=NAME."
        )
    return neutral


def _guessed(found: Mapping[str, Files]) -> str:
    """The one name that says it is the neutral, by the surest word that occurs."""
    counted = Counter(name for files in found.values() for name in files)
    for word in RESTING:
        named = [name for name in counted if word in re.split(r"[^a-z]+", name.lower())]
        everywhere = [name for name in named if counted[name] == len(found)]
        if len(everywhere) == 1:
            return everywhere[0]
        if everywhere:
            raise InvalidInput(
                f"dataset.neutral: {', '.join(sorted(everywhere))} may all be the face at rest; say which one is with "
                "dataset.neutral=NAME."
            )
        if named:
            return _resting(found, max(named, key=lambda name: (counted[name], name)))
    some = ", ".join(sorted(counted)[:8])
    raise InvalidInput(
        f"dataset.neutral: no mesh is named after the face at rest ({', '.join(RESTING)}), expected one in every "
        f"folder; say which one it is with dataset.neutral=NAME. There are {some}{', ...' if len(counted) > 8 else ''}."
    )
