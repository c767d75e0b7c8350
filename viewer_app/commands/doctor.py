"""``duplex doctor``: checks live capture on this machine, and states how to fix what does not work."""

import os
import platform
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path

from rich.console import Console
from rich.text import Text

from devices.capture.sensor_choice import NeedsChoiceError, choose_two
from devices.check import Check
from devices.live.checks import device_checks
from devices.live.sensors import connected_sensors
from viewer_app.commands.record import record
from viewer_app.errors import UsageError
from viewer_app.flags import in_flags
from viewer_app.options.sensing import DoctorOptions, RecordOptions
from viewer_app.options.shared import SensorOptions
from viewer_app.output_console import output_console
from viewer_app.sensors.bundle import SECONDS, collecting
from viewer_app.sensors.raw_files import RawFiles
from viewer_app.sensors.tracker import tracker_of
from viewer_app.viewer.display import environment_of_window, why_no_window, why_no_x
from viewer_app.viewer.window import why_nothing_is_drawn

_GREY = "bright_black"
_VIEWER_ANSWERS_WITHIN = 20.0  # seconds: the first start of a 100 MB program from a slow disk


def run(options: DoctorOptions) -> None:
    """Runs the command; exits with code 1 if ``duplex live`` could not start."""
    console = output_console()
    if options.bundle is None:
        if options.recording is not None:
            raise UsageError("--recording and --no-recording say what is in a bundle: add --bundle FILE.zip.")
        checks = _examine(options, console)
    else:
        serials = options.kinect_a, options.kinect_b, options.principal, options.sync_master
        paths = options.k4abt, options.tracker_model
        with collecting(options.bundle, console, force=options.force, serials=serials, paths=paths) as bundle:
            checks = _examine(options, console)
            if bundle.may_record(options.recording):
                bundle.record(partial(_record, options))
            bundle.write(checks, "\n".join(line.plain for line in report_lines(checks)))
    if lacks(checks):
        sys.exit(1)


def _examine(options: DoctorOptions, console: Console) -> list[Check]:
    """Checks everything, and prints the results."""
    tracker = tracker_of(options)
    choice = options.kinect_a, options.kinect_b, options.principal
    devices = device_checks(
        tracker, choice=choice, named_master=options.sync_master, x_answers=why_no_x() is None
    )
    checks = [
        replace(check, detail=in_flags(check.detail), advice=in_flags(check.advice))
        for check in (*devices, *program_checks())
    ]
    for line in report_lines(checks):
        console.print(line, soft_wrap=True)
    return checks


def report_lines(checks: list[Check]) -> list[Text]:
    """The report: sensors, what works, faults, what is not installed, what works now and the next step."""
    step = _next_step(checks)
    absent = [check for check in checks if check.about == "library" and check.missing]
    ranked = sorted((check for check in checks if check not in absent), key=_rank)
    lines = [_line(check, advised=check is not step) for check in ranked]
    if absent:
        lines.append(Text("Not installed; you need only the library for your sensors:", style=_GREY))
    lines += [Text(f"– {check.serves}: {check.install}", style=_GREY) for check in absent]
    lacking = lacks(checks)
    if lacking:
        lines.append(Text(f"duplex live cannot start. Missing: {', '.join(lacking)}."))
        works = "duplex demo, and duplex fuse with recordings"
        return [*lines, Text(f"Works now: {works}. Next: {step.advice if step is not None else ''}")]
    return [*lines, Text("duplex live can start. Next: duplex live --save s.rrd")]


def _next_step(checks: list[Check]) -> Check | None:
    """The check whose advice comes first: without any library, that for sensors."""
    failing = [check for check in checks if check.needed and not check.ok]
    if not any(check.ok for check in checks if check.about == "library"):
        failing.sort(key=lambda check: check.about != "sensor")
    return failing[0] if failing else None


def _record(options: DoctorOptions, folder: Path, console: Console, hide: Callable[[str], str]) -> None:
    """Records both sensors to a folder; of two that are connected, which one is A does not matter."""
    chosen = {each.name: getattr(options, each.name) for each in fields(SensorOptions)}
    try:
        choose_two(connected_sensors(None), options.kinect_a, options.kinect_b, options.principal)
    except NeedsChoiceError as question:
        chosen["principal"] = question.serials[0]
    record(
        RecordOptions(folder=folder, seconds=SECONDS, quiet=True, **chosen),
        console,
        RawFiles(folder, console, force=False, compress=True, hide=hide),
    )


def lacks(checks: list[Check]) -> list[str]:
    """What ``duplex live`` lacks, in words."""
    return [check.name for check in checks if check.needed and not check.ok]


def _rank(check: Check) -> int:
    """The place of a check in the report: sensors, libraries that work, the rest that works, faults."""
    if check.about == "sensor":
        return 0
    if check.ok:
        return 1 if check.about == "library" else 2
    return 3 if check.needed else 4


def _line(check: Check, advised: bool) -> Text:
    """A check as one line: a mark, its name, the result, the advice if wanted."""
    if not check.ok and not check.needed:
        mark, style = "–", _GREY if check.about == "machine" else "yellow"
    else:
        mark, style = ("✓", "green") if check.ok else ("✗", "bold red")
    text = Text(f"{mark} ", style=style)
    runs = f", runs {check.serves}" if check.about == "library" and check.ok else ""
    advice = check.advice if advised else ""
    separator = "" if not advice else " " if check.detail.endswith(".") else ". "
    rest = _GREY if style == _GREY else "default"
    text.append(check.name, style=_GREY if style == _GREY else "bold")
    text.append(" ".join(f": {check.detail}{runs}{separator}{advice}".split()), style=rest)
    return text


def program_checks(root: Path = Path("/")) -> list[Check]:
    """Checks of the rest of the program: display, graphics, viewer."""
    return [_display(), _graphics(root), _viewer()]


def _display() -> Check:
    why_not = why_no_window()
    if why_not is None:
        named = environment_of_window()
        return Check("display", True, named.get("WAYLAND_DISPLAY") or named.get("DISPLAY") or "yes")
    advice = "Use --save or --web."
    # duplex live can save without a display; the depth engine's own check covers what sensors need
    return Check("display", False, why_not, advice, needed=False)


def _graphics(root: Path) -> Check:
    """Whether a viewer draws here; one is started, without a window."""
    why_not = why_nothing_is_drawn()
    if why_not:
        advice = "Install the graphics driver, or for software rendering mesa-vulkan-drivers."
        return Check("graphics", False, why_not, advice, needed=False)
    devices = sorted(path.name for path in (root / "dev/dri").glob("render*"))
    if devices or platform.system() != "Linux":
        by = f"by device {devices[0]}" if devices else "by the system's own driver"
    else:
        by = "in software, slowly: there is no graphics device"
    return Check("graphics", True, f"the viewer draws {by}", needed=False)


def _viewer() -> Check:
    installed = version("rerun-sdk")
    try:
        answer = subprocess.run(
            [sys.executable, "-m", "rerun", "--version"],
            capture_output=True,
            text=True,
            timeout=_VIEWER_ANSWERS_WITHIN,
            env={**os.environ, "RERUN_ANALYTICS": "0"},
        )
    except (OSError, subprocess.TimeoutExpired) as fault:
        return Check("viewer", False, f"rerun does not start ({fault})", _REINSTALL)
    if answer.returncode != 0:
        last = (answer.stderr.strip() or "no word").splitlines()[-1]
        return Check("viewer", False, f"rerun does not start ({last})", _REINSTALL)
    found = answer.stdout.split()
    if installed not in found:
        detail = f"the program is {' '.join(found[:2])}, rerun-sdk {installed}"
        return Check("viewer", False, detail, _REINSTALL)
    return Check("viewer", True, f"rerun {installed}")


_REINSTALL = "Reinstall it: pip install --force-reinstall rerun-sdk."
