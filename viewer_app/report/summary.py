"""The summary in the terminal: a few aligned lines that lead with the figures that matter.

How well the two views agree, how much of the data had to be repaired, and how fast S* comes. Lines after
these three appear only where there is something to say. :mod:`viewer_app.report.details` prints all else.
"""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from fusion.calibration.calibration import Calibration
from recordings.events import Event
from viewer_app.coach.advice import ANGLES, GOOD, USABLE, placement, quality
from viewer_app.report.details import FEWEST_FRAMES, print_details
from viewer_app.report.event_list import UNSETTLED, list_events, seconds_of
from viewer_app.report.figures import Figures, FusionResult
from viewer_app.report.numbers_in_words import in_bytes, in_mm, in_percent
from viewer_app.viewer.display import has_display

_LABEL_WIDTH = 13
_MIRRORED = 0.6
"""Share of frames in both views; real walks stay below 0.3."""
_CALIBRATE = "Calibrate: stand still for a second, arms and legs apart, where both sensors see all of you"


@dataclass(frozen=True)
class Line:
    """One line of the summary.

    Attributes:
        label: The subject, one or two words.
        text: The figure and what it means.
        warning: Whether someone should act on it.
    """

    label: str
    text: str
    warning: bool = False


def print_lines(console: Console, lines: Iterable[Line]) -> None:
    """Prints lines with aligned texts. The label is bold, a warning yellow; neither carries the meaning."""
    for line in lines:
        grid = Table.grid()
        grid.add_column(width=_LABEL_WIDTH, no_wrap=True)
        grid.add_column(overflow="fold")
        grid.add_row(Text(line.label, "bold"), Text(line.text, "yellow" if line.warning else ""))
        console.print(grid, highlight=False)


def print_summary(
    console: Console,
    result: FusionResult,
    figures: Figures,
    events: Iterable[Event] = (),
    verbose: bool = False,
) -> None:
    """Prints the summary of fused recordings.

    Args:
        console: Receives the output.
        result, figures: The data of the report and the report.
        events: Events whose warnings are told; none if they are printed elsewhere.
        verbose: Whether all figures follow.
    """
    print_lines(
        console, [*fusion_lines(result.calibration, figures), *shortfalls(figures), *_warnings(events)]
    )
    if verbose:
        print_details(console, result, figures)


def fusion_lines(
    calibration: Calibration, figures: Figures, latency_ms: dict[str, float | None] | None = None
) -> Iterator[Line]:
    """The lines that lead every summary.

    Args:
        calibration: The last calibration.
        figures: At least :func:`viewer_app.report.figures.method_figures`.
        latency_ms: Of live sensors: milliseconds from the images to S*, ``p50`` and ``p99``.
    """
    yield _agreement(calibration, figures)
    yield Line("Repaired", _repaired(figures["repaired"]))
    yield Line("S*", _pace(figures, latency_ms or {}))
    yield Line("Bones", _bones(figures["bone_error_mm"]))
    for advice in placement(calibration):
        if advice.topic == "angle":
            yield Line("Placement", _placement(advice.figure), warning=True)


def _placement(angle: float) -> str:
    low, high = ANGLES
    way = "further apart" if angle < low else "closer together"
    return (
        f"{angle:.0f}° between the sensors; good is {low:.0f}° to {high:.0f}°. Move them {way} round the "
        "person."
    )


def say_saved(console: Console, path: Path) -> None:
    """Prints where the session is, and the command to view it, as this program was called."""
    called = Path(sys.argv[0])
    found = shutil.which("duplex")
    on_path = found is not None and Path(found).resolve() == called.resolve()
    program = str(called) if called.name.startswith("duplex") and not on_path else "duplex"
    page = "" if has_display() else f" --html {path.with_suffix('.html')}"
    size = in_bytes(path.stat().st_size)
    # a command must be copied in one piece: no wrapping
    console.print(
        f"{'Saved':{_LABEL_WIDTH}}{path}, {size}. Look at it with: {program} review {path}{page}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def say_more(console: Console, others: str = "as data with --report FILE.json") -> None:
    """Prints where all other figures are: in the terminal, and `others`."""
    print_lines(console, [Line("All figures", f"with --verbose; {others}.")])


def _agreement(calibration: Calibration, figures: Figures) -> Line:
    registration = calibration.registration
    if calibration.how.startswith(UNSETTLED):
        return Line("Views agree", f"unknown: not calibrated yet. {_CALIBRATE}.", warning=True)
    apart = figures["disagreement_mm"]["median"]
    if registration is not None:
        apart = registration.residual_median * 1e3
        if registration.frames < FEWEST_FRAMES:
            text = f"too few frames to tell: {in_mm(apart)} apart over {registration.frames}; at least "
            return Line("Views agree", f"{text}{FEWEST_FRAMES} are needed. {_CALIBRATE}.", warning=True)
    if apart is None:
        return Line("Views agree", "unknown: no joint was seen by both sensors", warning=True)
    word = quality(apart)
    limit = {
        "good": "",
        "usable": f"; good is below {GOOD:.0f} mm",
        "poor": f"; usable is below {USABLE:.0f} mm. {_CALIBRATE}",
    }
    return Line("Views agree", f"{word}: {in_mm(apart)} apart (median){limit[word]}.", warning=word == "poor")


def _repaired(repaired: Figures) -> str:
    filled_in = f"joints filled in: {in_percent(repaired['unseen_joints'])}."
    exchanged = repaired["exchanged"]
    if exchanged is None:
        return filled_in
    a, b = in_percent(exchanged["a"]), in_percent(exchanged["b"])
    return f"left and right: {a} of A, {b} of B; {filled_in}"


def _pace(figures: Figures, latency_ms: dict[str, float | None]) -> str:
    frames, seconds, rate = figures["fused_frames"], figures["seconds"], figures["frames_per_second"]
    each = "" if rate is None else f", {rate:.1f} per second"
    if latency_ms.get("p50") is None:
        counted = "1 frame" if frames == 1 else f"{frames} frames"
        return f"{counted} in {seconds:.1f} s{each}."
    late = f"{latency_ms['p50']:.0f} ms after the images (99 %: {latency_ms['p99']:.0f} ms)"
    return f"{late}{each}, last {seconds:.1f} s."


def _bones(error_mm: Figures) -> str:
    a, b, fused = (in_mm(error_mm[key]["max"]) for key in ("a", "b", "fused"))
    return f"S* within {fused} of their lengths; S_A up to {a} off, S_B {b}."


def shortfalls(figures: Figures) -> Iterator[Line]:
    """The lines about what recordings lack: partners, people, sides."""
    dropped, absent, frames = figures["dropped"], figures["without_person"], figures["frames"]
    if dropped["a"] or dropped["b"]:
        of_a, of_b = (f"{dropped[key]} of {frames[key]}" for key in ("a", "b"))
        yield Line("Dropped", f"{of_a} frames of A and {of_b} of B have no partner.", warning=True)
    if absent["a"] or absent["b"]:
        yield Line(
            "No person", f"in {absent['a']} frames of A, {absent['b']} of B, {absent['both']} of both."
        )
    exchanged = figures["repaired"]["exchanged"]
    if exchanged is not None and min(exchanged["a"] or 0.0, exchanged["b"] or 0.0) > _MIRRORED:
        text = (
            "Left and right are exchanged in both views most of the time. If the person faced the sensors, "
        )
        yield Line(
            "Mirrored?", f"{text}x points to the wrong side in both files: change its sign.", warning=True
        )


def _warnings(events: Iterable[Event]) -> Iterator[Line]:
    warned = [event for event in list_events(events) if event.level != "INFO"]
    if warned:
        first = warned[0]
        more = f" ({len(warned) - 1} more)" if len(warned) > 1 else ""
        yield Line("Warning", f"{seconds_of(first.time_ns)}: {first.text}{more}", warning=True)
