"""What ``duplex doctor --bundle`` writes for a maintainer: findings, versions, logs, a recording."""

import io
import json
import os
import platform
import re
import sys
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, suppress
from dataclasses import asdict
from importlib.metadata import requires
from pathlib import Path
from typing import Any

from rich.console import Console

from devices.capture.usb import usb_kinects
from devices.check import Check, installed_version
from devices.live.checks import log_libraries_to
from devices.live.sensors import connected_sensors
from devices.output_file import Hidden, real_path, whole_file
from devices.sensor import DeviceError
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.output_files import check_outputs
from viewer_app.sensors.anonymity import Anonymity

SECONDS = 10.0
_WHAT = (
    f"{SECONDS:g} seconds of depth and infrared images of both sensors, up to 350 MB, in which you and the "
    f"room can be seen"  # that size is of 640 × 576 pixels: python -m tests.experiments.recording_cost
)
_PROGRAM = "duplex-kinects"
_OTHERS = ("pyk4a-bundle", "pyorbbecsdk", "pyorbbecsdk2")  # sensors' packages that are no requirement of ours


class Bundle:
    """What becomes the ``.zip``; see :func:`collecting`."""

    def __init__(self, path: Path, folder: Path, hide: Anonymity, console: Console, force: bool) -> None:
        self._path, self._folder, self._hide, self._console = path, folder, hide, console
        self._force = force
        self._log = ""

    def may_record(self, answer: bool | None) -> bool:
        """Whether to record: as the option says, else as the person at the terminal answers."""
        if answer is None and sys.stdin.isatty():
            with suppress(EOFError):
                said = self._console.input(f"May the file have {_WHAT}? \\[y/N] ")
                return said.strip().lower() in ("y", "yes")
        if answer is None:
            self._console.print(f"Without a recording; --recording adds {_WHAT}.", soft_wrap=True)
        return bool(answer)

    def record(self, record: Callable[[Path, Console, Callable[[str], str]], object]) -> None:
        """Records to a folder, and prints how that went; a failure is a finding, too."""
        self._hide.learn(_connected_serials())  # also of those plugged in meanwhile
        printed, raw = io.StringIO(), self._folder / "raw"
        with self._console.status(f"recording {SECONDS:g} seconds …"):
            try:
                record(raw, Console(file=printed, highlight=False, width=200), self._hide)
            except (DeviceError, UsageError) as fault:
                print(fault, file=printed)
        self._log = in_flags(printed.getvalue()).replace(f"{raw}{os.sep}", "")
        self._console.print(self._log, markup=False, soft_wrap=True, end="")

    def write(self, checks: Sequence[Check], text: str) -> None:
        """Writes the file: what doctor found, as data and as the text that it printed, and the rest.

        Raises:
            UsageError: It could not be written.
        """
        self._hide.learn(_connected_serials())
        findings = [self._hidden(check) for check in checks]
        data = json.dumps({"versions": _versions(self._hide), "checks": findings}, indent=1)
        with (
            whole_file(self._path, overwrite=self._force) as hidden,
            zipfile.ZipFile(hidden, "w", zipfile.ZIP_DEFLATED) as file,
        ):
            logs = [f"== recording\n{self._log}"]
            for log in sorted(self._folder.glob("*.log")):
                logs.append(f"== {log.stem}\n{log.read_text(encoding='utf-8', errors='replace')}")
            file.writestr("doctor.txt", self._hide(text))
            file.writestr("doctor.json", data)
            file.writestr("log.txt", self._hide("\n".join(logs)))
            for recording in sorted(self._folder.glob("raw/*.mkv")):
                file.write(recording, recording.name, zipfile.ZIP_STORED)
        said = f"{self._path}, {self._path.stat().st_size / 1e6:.1f} MB: look at it before you send it."
        self._console.print(said, markup=False, soft_wrap=True)

    def _hidden(self, check: Check) -> dict[str, Any]:
        """A finding as data. Detail and advice are one text, which may have been parted within a path."""
        found = {
            key: self._hide(value) if isinstance(value, str) else value
            for key, value in asdict(check).items()
        }
        found["detail"], _, found["advice"] = self._hide(f"{check.detail}. {check.advice}").partition(". ")
        return found


@contextmanager
def collecting(
    path: Path, console: Console, *, force: bool, serials: Iterable[str | None], paths: Iterable[Path | None]
) -> Iterator[Bundle]:
    """A bundle that will be written to `path`; within the block, the logs of the sensors' libraries go to it.

    Names of user and machine, paths, addresses and serial numbers are replaced in all of it.

    Args:
        serials: Those that the options name, beside those of the connected sensors.
        paths: Files and folders that the options name.

    Raises:
        UsageError: The file cannot be written, or it exists and `force` is not set.
    """
    named = list(filter(None, paths))
    check_outputs([path], named, force)
    if path.suffix.lower() != ".zip":
        raise UsageError(f"--bundle {path}: its name must end in .zip.")
    try:
        hidden = Hidden(real_path(path), folder=True)
    except OSError as fault:
        raise UsageError(f"{path} could not be written: {fault.strerror or fault}.") from None
    folder = hidden.path
    with ExitStack() as stack:
        stack.callback(hidden.remove)
        stack.enter_context(_standard_error_to(folder / "stderr.log"))
        log_libraries_to(folder)
        hide = Anonymity([*filter(None, serials), *_connected_serials()], named)
        yield Bundle(path, folder, hide, console, force)


def _connected_serials() -> set[str]:
    serials = {device.serial for device in usb_kinects()}
    with suppress(DeviceError):
        serials |= {sensor.serial or "" for sensor in connected_sensors(None)}
    return serials - {""}


@contextmanager
def _standard_error_to(path: Path) -> Iterator[None]:
    """What this process and its libraries write to standard error goes to a file."""
    kept = os.dup(2)
    with path.open("a", encoding="utf-8", errors="replace", buffering=1) as file:
        try:
            os.dup2(file.fileno(), 2)
            with redirect_stderr(file):
                yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _versions(hide: Callable[[str], str]) -> dict[str, Any]:
    packages = {_PROGRAM, *_OTHERS}
    for requirement in requires(_PROGRAM) or ():
        packages |= set(re.findall(r"^[\w.-]+", requirement))
    distribution = ""
    with suppress(OSError):  # not on this system
        distribution = platform.freedesktop_os_release().get("PRETTY_NAME", "")
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": hide(f"{platform.platform()} {distribution}"),
        "processor": hide(f"{platform.machine()} {platform.processor()}, {os.cpu_count()} cores"),
        "packages": {name: found for name in sorted(packages) if (found := installed_version(name))},
    }
