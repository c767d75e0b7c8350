"""One pair to fuse, its folder in the output, and the record by which a finished session is recognised.

A session's folder is made under a temporary name and renamed when it is complete, so a folder that has its
final name is complete. A worker deletes only its own temporary folder; the command deletes all remains.
"""

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

from devices.input_file import open_input
from fusion.setup import REVISIONS
from viewer_app.batch.finding import Pair
from viewer_app.options.sensing import BatchOptions, FuseOptions
from viewer_app.options.shared import NAMES, calibration_source

RECORD, PARTIAL = "record.json", ".partial"
"""Names of a session's record, and of the folder of what is not complete, in the output folder."""
_ELSEWHERE = {"source", "out", "processes", "scheduler", "pages", "force"}
"""Options of the command that do not change a session."""
_SHARED = [field.name for field in fields(BatchOptions) if field.name not in _ELSEWHERE]
"""Options that ``duplex fuse`` has as well."""

Record = dict[str, Any]


@dataclass(frozen=True)
class Job:
    """A pair to fuse."""

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
        """The temporary folder of this process for the session: a cluster may repeat a job elsewhere."""
        return self.options.out / PARTIAL / f"{self.name}.{socket.gethostname()}-{os.getpid()}"

    @property
    def _replaced(self) -> Path:
        """Where the older session is while another takes its place."""
        return self.options.out / PARTIAL / f"{self.name}.old"

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
        """Everything that the session depends on: input files' contents, options, version, method's revision.

        Raises:
            OSError: An input file or the calibration cannot be read.
        """
        pair = self.pair
        files = {"a": pair.a, "b": pair.b, "skeletons_a": pair.skeletons_a, "skeletons_b": pair.skeletons_b}
        return {
            "program": program_version(),
            "method_revision": REVISIONS[self.options.method],
            "files": {side: None if path is None else checksum(path) for side, path in files.items()},
            "persons": [pair.person_a, pair.person_b],
            "options": {name: _value(name, getattr(self.options, name)) for name in _SHARED},
        }

    def record(self) -> Record | None:
        """The record in the session's folder, which may lack other files; None if there is no session.

        That of a session whose record cannot be read has no identity.
        """
        with suppress(OSError, ValueError, RecursionError):
            record = json.loads((self.folder / RECORD).read_text(encoding="utf-8"))
            if isinstance(record, dict) and {"identity", "figures"} <= record.keys():
                return record
        return {"identity": {}} if self.session.exists() else None

    @property
    def is_whole(self) -> bool:
        """Whether the session's folder has all files that the options ask for."""
        needed = [self.session, self.report, *([self.page] if self.options.pages else [])]
        return all(path.is_file() for path in needed)

    def strangers(self) -> list[str]:
        """Names of files in the session's folder that ``duplex batch`` did not write there."""
        if not self.folder.exists():
            return []
        if not self.folder.is_dir():
            return [self.folder.name]
        own = {self.session.name, self.page.name, self.report.name, RECORD}
        return sorted({path.name for path in self.folder.iterdir()} - own)

    def place(self) -> None:
        """Renames the complete temporary folder to :attr:`folder`; an older session is replaced.

        Raises:
            OSError: It cannot be renamed. The older session is back in its place.
        """
        shutil.rmtree(self._replaced, ignore_errors=True)
        if self.folder.exists():
            self.folder.rename(self._replaced)
        try:
            self.partial.rename(self.folder)
        except OSError:
            if self._replaced.exists():
                self._replaced.rename(self.folder)
            raise
        shutil.rmtree(self._replaced, ignore_errors=True)


@dataclass(frozen=True)
class Outcome:
    """The result of a job."""

    name: str  # of the session
    record: Record | None  # the record of the session; None if it failed
    error: str = ""  # the line that says why it failed; empty if it did not


def tidy(out: Path) -> None:
    """Restores sessions that a killed worker was about to replace, and deletes what is not complete."""
    for old in (out / PARTIAL).glob("*.old"):
        session = out / old.name.removesuffix(".old")
        if not session.exists():
            old.rename(session)
    shutil.rmtree(out / PARTIAL, ignore_errors=True)


def program_version() -> str:
    """The version of the program on this machine."""
    return version("duplex-kinects")


def checksum(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal."""
    with open_input(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _value(name: str, option: Any) -> Any:
    """An option for the record; a file is represented by its content."""
    # A word such as duplex is no file, even if the present folder has a file of this name.
    calibration = calibration_source(option) if name == "calibrate" else None
    if isinstance(calibration, Path):
        return f"sha256:{checksum(calibration)}"
    option = Path(option) if name in NAMES and option else option
    if isinstance(option, Path) and option.is_file():
        return f"sha256:{checksum(option)}"
    return str(option) if isinstance(option, Path) else option
