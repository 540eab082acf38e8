"""Files that are whole or absent: written under a temporary name and moved into place."""

from __future__ import annotations

import errno
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import platformdirs

from retarget.check import InvalidInput


def cache_folder(chosen: str | Path | None = None) -> Path:
    """The folder that was chosen, or the user's cache folder of this project."""
    return Path(platformdirs.user_cache_dir("anacondar")) if chosen is None else Path(chosen).expanduser()


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Call write(temporary) and move the result to path. Raises InvalidInput for a full disk or a closed folder."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write(temporary)
        temporary.replace(path)
    except OSError as error:
        if path.parent.is_dir():
            temporary.unlink(missing_ok=True)
        full = error.errno in (errno.ENOSPC, errno.EDQUOT)
        what = "the disk is full" if full else f"it cannot be written ({error.strerror or error})"
        remedy = "Free some space" if full else "Make the folder writable or choose another, e.g. paths.results=FOLDER"
        raise InvalidInput(
            f"{path}: {what}. What was finished before is kept and no file is half written. {remedy}, "
            "then start the same command again: it continues where it stopped."
        ) from error


def write_whole_folder(folder: Path, write: Callable[[Path], object]) -> None:
    """Call write(temporary folder) and move the result to folder, in the place of what was there. Raises InvalidInput.

    A folder that is there stays as it was until the new one is complete.
    """
    temporary, old = (folder.with_name(f".{folder.name}.{os.getpid()}.tmp.{what}") for what in ("new", "old"))
    try:
        temporary.mkdir(parents=True)
        write(temporary)
        if folder.exists():
            folder.replace(old)
        temporary.replace(folder)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        if old.exists() and not folder.exists():
            old.replace(folder)
        raise InvalidInput(
            f"{folder}: it cannot be written ({error.strerror or error}). Nothing there was changed. Free some space "
            "or choose another folder."
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def check_folder(folder: Path, setting: str = "paths.results=FOLDER") -> None:
    """Raises InvalidInput unless files can be written there; clears what a killed process left half written.

    `setting` is what chooses another folder.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidInput(
            f"{folder}: nothing can be written there ({error.strerror or error}). Make the folder writable or choose "
            f"another with {setting}."
        ) from error
    for temporary in folder.glob("*/.*.tmp.*"):
        writer = temporary.name.split(".tmp.")[0].rsplit(".", 1)[-1]
        if writer.isdigit() and not _alive(int(writer)):
            temporary.unlink(missing_ok=True)


def _alive(process: int) -> bool:
    if os.name == "nt":  # where asking with signal 0 would end the process
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True
