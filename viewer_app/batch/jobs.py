"""One pair to fuse, its folder in the output, and the record by which a finished session is recognised.

A session's folder is made under a temporary name and renamed when it is complete. A folder that has its
final name is therefore complete.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
from contextlib import suppress
from dataclasses import dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

from viewer_app.batch.finding import Pair
from viewer_app.options.sensing import BatchOptions, FuseOptions

RECORD = "record.json"
_ELSEWHERE = {"source", "out", "processes", "scheduler", "pages", "force"}
"""Options of the command that do not change a session."""
_SHARED = [field.name for field in fields(BatchOptions) if field.name not in _ELSEWHERE]
"""Options that ``duplex fuse`` has as well."""
_BLOCK = 1 << 20

Record = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A pair to fuse.

    Attributes:
        pair: The recordings.
        options: The options of the command.
    """

    pair: Pair
    options: BatchOptions

    @property
    def name(self) -> str:
        """The name of the session."""
        return self.pair.name

    @property
    def folder(self) -> Path:
        """The session's folder."""
        return self.options.out / self.name

    @property
    def partial(self) -> Path:
        """The temporary folder of this process for the session."""
        return self._partials / f"{socket.gethostname()}-{os.getpid()}"

    @property
    def _partials(self) -> Path:
        return self.options.out / ".partial" / self.name

    @property
    def session(self) -> Path:
        """The session."""
        return self.folder / f"{self.name}.rrd"

    @property
    def page(self) -> Path:
        """The session's page; written if ``--pages`` is set."""
        return self.folder / f"{self.name}.html"

    @property
    def report(self) -> Path:
        """The session's report, as of ``duplex fuse --report``."""
        return self.folder / f"{self.name}.json"

    def fuse_options(self, folder: Path) -> FuseOptions:
        """The options of the ``duplex fuse`` that fuses this pair into a folder."""
        pair = self.pair
        return FuseOptions(
            a=pair.a,
            b=pair.b,
            skeletons_a=pair.skeletons_a,
            skeletons_b=pair.skeletons_b,
            person_a=pair.person_a,
            person_b=pair.person_b,
            no_viewer=True,
            save=folder / self.session.name,
            report=folder / self.report.name,
            **{name: getattr(self.options, name) for name in _SHARED},
        )

    def identity(self) -> Record:
        """Everything that the session depends on: contents of the input files, options, program version.

        Raises:
            OSError: An input file or the calibration cannot be read.
        """
        pair = self.pair
        files = {"a": pair.a, "b": pair.b, "skeletons_a": pair.skeletons_a, "skeletons_b": pair.skeletons_b}
        return {
            "program": program_version(),
            "files": {side: None if path is None else checksum(path) for side, path in files.items()},
            "persons": [pair.person_a, pair.person_b],
            "options": {name: _value(name, getattr(self.options, name)) for name in _SHARED},
        }

    def record(self) -> Record | None:
        """The record of the finished session; None if there is no complete session."""
        needed = [self.session, self.report, *([self.page] if self.options.pages else [])]
        if not all(path.is_file() for path in needed):
            return None
        try:
            record = json.loads((self.folder / RECORD).read_text(encoding="utf-8"))
        except (OSError, ValueError):
            return None
        return record if isinstance(record, dict) and {"identity", "figures"} <= record.keys() else None

    def strangers(self) -> list[str]:
        """Names of files in the session's folder that ``duplex batch`` did not write there."""
        if not self.folder.exists():
            return []
        if not self.folder.is_dir():
            return [self.folder.name]
        own = {self.session.name, self.page.name, self.report.name, RECORD}
        return sorted({path.name for path in self.folder.iterdir()} - own)

    def restore(self) -> None:
        """Restores a session that a killed run was about to replace."""
        for old in self._partials.glob("*.old"):
            if not self.folder.exists():
                old.rename(self.folder)
                self._drop_empty()

    def drop_partials(self) -> None:
        """Deletes the remains of this session from an interrupted run."""
        self.restore()
        shutil.rmtree(self._partials, ignore_errors=True)
        self._drop_empty()

    def drop_own_partial(self) -> None:
        """Deletes the temporary folder of this process."""
        shutil.rmtree(self.partial, ignore_errors=True)
        self._drop_empty()

    def _drop_empty(self) -> None:
        with suppress(OSError):  # another process or another session is in it
            if self._partials.is_dir():
                self._partials.rmdir()
            self._partials.parent.rmdir()

    def place(self) -> None:
        """Renames the complete temporary folder to :attr:`folder`; an older session is replaced.

        Raises:
            OSError: It cannot be renamed. The older session is back in its place.
        """
        old = self.partial.with_name(f"{self.partial.name}.old")
        replaced = self.folder.exists()
        if replaced:
            self.folder.rename(old)
        try:
            self.partial.rename(self.folder)
        except OSError:
            if replaced:
                old.rename(self.folder)
            raise
        if replaced:
            shutil.rmtree(old, ignore_errors=True)


@dataclass(frozen=True)
class Outcome:
    """The result of a job.

    Attributes:
        name: Of the session.
        record: The record of the session; None if it failed.
        error: The line that says why it failed; empty if it did not.
    """

    name: str
    record: Record | None
    error: str = ""


def program_version() -> str:
    """The version of the program on this machine."""
    return version("duplex-kinects")


def checksum(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()


def calibration_file(calibrate: str) -> Path | None:
    """The file that ``--calibrate`` names; None for ``auto`` and ``seconds:N``."""
    return None if calibrate == "auto" or calibrate.startswith("seconds:") else Path(calibrate)


def _value(name: str, option: Any) -> Any:
    """An option for the record; a file is represented by its content."""
    # A word such as duplex is no file, even if the present folder has a file of this name.
    calibration = calibration_file(option) if name == "calibrate" else None
    if calibration is not None:
        return f"sha256:{checksum(calibration)}"
    if isinstance(option, Path) and option.is_file():
        return f"sha256:{checksum(option)}"
    return str(option) if isinstance(option, Path) else option
