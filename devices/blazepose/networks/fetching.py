"""Fetches the tracker's network files from the published packages that carry them, with pip or npm."""

import hashlib
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path

from devices.blazepose.networks.files import (
    DETECTOR,
    LANDMARK_NETWORKS,
    WHEEL,
    NetworkFile,
    checked_content,
    files_of,
)
from devices.blazepose.settings import NetworkName
from devices.output_file import whole_file
from devices.sensor import DeviceError

LICENCE, NOTICE = "LICENSE-mediapipe.txt", "NOTICE.txt"
"""Files that are kept beside the networks: the Apache License 2.0, and where each file came from."""

_UNREACHABLE = re.compile(r"Retrying \(|ENOTFOUND|ECONNREFUSED|EAI_AGAIN|ETIMEDOUT|ENETUNREACH")
_LICENCE_IN_WHEEL = "mediapipe-0.10.21.dist-info/LICENSE"
_ELSEWHERE = (
    "On a machine with a package index, duplex tracker fetch --tracker-model DIR makes a folder to copy; "
    "name it here with `tracker_model=DIR`."
)
# The networks do not depend on the platform. This wheel is the smallest.
_PIP_OPTIONS = (
    *("--disable-pip-version-check", "--no-input", "--quiet", "download", "--no-deps", "--only-binary=:all:"),
    *("--python-version", "3.12", "--implementation", "cp", "--abi", "cp312"),
    *("--platform", "manylinux_2_28_x86_64", "--retries", "1", "--timeout", "15"),
)


def fetch(network: NetworkName, folder: Path) -> list[Path]:
    """Fetches the files of a network that the folder lacks or has damaged, with licence and notice.

    A file appears in the folder whole and checked, or not at all. Returns those that were fetched.

    Raises:
        DeviceError: There is no pip (or npm, for ``lite``) or package index, or the folder cannot be written.
    """
    if folder.exists() and not folder.is_dir():
        raise DeviceError(f"{folder} is not a folder. Name a folder for the tracker's networks.")
    wanted = [file for file in files_of(network) if not _whole(file, folder)]
    fetched: list[Path] = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for package in dict.fromkeys(file.package for file in wanted):
            with tempfile.TemporaryDirectory(prefix="duplex-tracker-") as temporary:
                archive = _downloaded(package, Path(temporary))
                members = {file.name: file.member for file in wanted if file.package == package}
                if package == WHEEL:
                    members[LICENCE] = _LICENCE_IN_WHEEL
                contents = _members(archive, list(members.values()))
                for file in wanted:
                    if file.package == package:
                        _check(file, contents[file.member])
                placed = {name: contents[member] for name, member in members.items()}
                for name, content in {NOTICE: _notice().encode(), **placed}.items():
                    with whole_file(folder / name, overwrite=True) as hidden:
                        hidden.write_bytes(content)
                fetched += [folder / name for name in placed]
    except OSError as fault:
        raise DeviceError(
            f"The tracker's networks cannot be kept in {folder}: {fault.strerror or fault}."
        ) from None
    return fetched


def _whole(file: NetworkFile, folder: Path) -> bool:
    try:
        checked_content(file, folder)
    except DeviceError:
        return False
    return True


def _downloaded(package: str, folder: Path) -> Path:
    """Downloads a package's archive into an empty folder."""
    made = folder / "archive"
    made.mkdir()
    if package == WHEEL:
        command = [*_pip(), *_PIP_OPTIONS, "--dest", str(made), package]
    else:
        npm = shutil.which("npm")
        if npm is None:
            raise DeviceError(
                f"The network lite is only in the npm package {package}, and npm is not installed. "
                f"Install npm, or use the network full."
            )
        command = [npm, "pack", "--loglevel=error", "--pack-destination", str(made), package]
    _run(command, package, folder)
    archives = [path for path in made.iterdir() if path.suffix in (".whl", ".tgz")]
    if len(archives) != 1:
        raise DeviceError(f"{package} cannot be fetched: the download gave no package. {_ELSEWHERE}")
    return archives[0]


def _pip() -> list[str]:
    """The command of a pip: this interpreter's, else one on the PATH. Its own Python does not matter."""
    own = [sys.executable, "-m", "pip"]
    if subprocess.run([*own, "--version"], capture_output=True, check=False).returncode == 0:
        return own
    for name in ("pip3", "pip"):
        found = shutil.which(name)
        if found is not None:
            return [found]
    raise DeviceError(
        f"The tracker's networks are fetched with pip, and {sys.executable} has none. Run "
        f"{Path(sys.executable).name} -m ensurepip. {_ELSEWHERE}"
    )


def _run(command: Sequence[str], package: str, folder: Path) -> None:
    """Runs a download; its temporary files go into the folder."""
    environment = os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    try:
        done = subprocess.run(
            command, stdin=subprocess.DEVNULL, capture_output=True, env=environment, cwd=folder, check=False
        )
    except OSError as fault:
        raise DeviceError(f"{command[0]} cannot be started: {fault}. {_ELSEWHERE}") from None
    if done.returncode != 0:
        said = (done.stdout + done.stderr).decode(errors="replace")
        errors = [line for line in said.splitlines() if "error" in line.lower()] or ["no word of why"]
        why = "no package index can be reached" if _UNREACHABLE.search(said) else errors[-1].strip()[:200]
        raise DeviceError(f"{package} cannot be fetched: {why.rstrip('.')}. {_ELSEWHERE}")


def _members(archive: Path, names: Sequence[str]) -> dict[str, bytes]:
    """The named files of a wheel or an npm package."""
    try:
        if archive.suffix == ".whl":
            with zipfile.ZipFile(archive) as wheel:
                return {name: wheel.read(name) for name in names}
        with tarfile.open(archive) as package:
            found = {name: package.extractfile(name) for name in names}
            return {name: member.read() for name, member in found.items() if member is not None}
    except (KeyError, zipfile.BadZipFile, tarfile.TarError) as fault:
        raise DeviceError(f"{archive.name} is not the expected package: {fault}. {_ELSEWHERE}") from None


def _check(file: NetworkFile, content: bytes) -> None:
    if hashlib.sha256(content).hexdigest() != file.sha256:
        raise DeviceError(f"{file.name} of {file.package} has another SHA-256 than expected; it is not used.")


def _notice() -> str:
    rows = "".join(
        f"{file.name}: {file.member} of {file.package}\n" for file in (DETECTOR, *LANDMARK_NETWORKS.values())
    )
    return (
        "BlazePose networks of MediaPipe, Copyright The MediaPipe Authors (Google LLC).\n"
        f"Apache License 2.0, see {LICENCE}. Unchanged files of published packages:\n{rows}"
    )
