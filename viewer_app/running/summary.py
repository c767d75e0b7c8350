"""The summary of a live session with real or simulated sensors."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from rich.console import Console

from devices.capture.sensor_pair import TwoSensors
from devices.sensor import LinkFigures
from fusion.setup import FusionSetup
from recordings.session_arrays import RecordedFrame, SessionArrays
from viewer_app.errors import UsageError
from viewer_app.output_files import whole_file
from viewer_app.outputs.opening import print_outputs
from viewer_app.outputs.output import LiveOutput
from viewer_app.report.details import print_method
from viewer_app.report.figures import Figures, fusion_figures, method_figures, report_to_json
from viewer_app.report.summary import Line, fusion_lines, print_lines, say_saved
from viewer_app.sinks.session_file import FileSink


def print_frames(console: Console, sensors: TwoSensors) -> None:
    """Prints how many frames were received, paired and dropped."""
    figures = sensors.figures
    console.print(
        f"[bold]Paired[/] {figures.pairs} frames of {sensors.a.received} (A) and {sensors.b.received} (B); "
        f"alone {figures.alone_a} and {figures.alone_b}; of B {figures.unmatched_b} that A has no frame for."
    )
    small = {"frames late": figures.late, "repeated": figures.repeated, "out of order": figures.reordered}
    if any(small.values()):
        console.print(f"{_counts_in_words(small)}.", highlight=False)
    for side, link in zip("AB", sensors.links, strict=True):
        if link is not None:
            console.print(f"{side} by network: {_link_in_words(link)}.", highlight=False)
    if figures.offset_ns is not None:
        console.print(
            f"B's clock less A's: {figures.offset_ns * 1e-6:.1f} ms, drifting {figures.drift_ppm:.0f} ppm."
        )


def _stream_trouble(sensors: TwoSensors) -> Iterator[Line]:
    """What someone should fix: frames dropped, sensors and messages lost, clocks reset or not related."""
    dropped = {
        "frames of A dropped (too slow)": sensors.a.dropped,
        "frames of B dropped (too slow)": sensors.b.dropped,
        "reconnects of A": sensors.a.returns,
        "reconnects of B": sensors.b.returns,
        "clocks reset": sensors.figures.resets,
    }
    if any(dropped.values()):
        yield Line("Streams", f"{_counts_in_words(dropped)}.", warning=True)
    for side, link in zip("AB", sensors.links, strict=True):
        if link is not None and (link.lost or link.malformed or link.restarts or link.clock_bound_ns is None):
            yield Line("Network", f"{side}: {_link_in_words(link)}.", warning=True)


def _counts_in_words(counts: dict[str, int]) -> str:
    return ", ".join(f"{what} {count}" for what, count in counts.items() if count)


def _link_in_words(link: LinkFigures) -> str:
    counts = {"lost": link.lost, "damaged messages": link.malformed, "restarts": link.restarts}
    said = _counts_in_words(counts)
    said = f"frames arrived: {link.received}, {said or 'none lost'}"
    if link.round_trip_ns is None or link.clock_bound_ns is None:
        return f"{said}; the clocks of the two PCs could not be related"
    trip_ms, bound_ms = link.round_trip_ns * 1e-6, link.clock_bound_ns * 1e-6
    return f"{said}; round trip {trip_ms:.1f} ms, clocks related within {bound_ms:.1f} ms"


def rows_since_calibration(setup: FusionSetup, frames: Sequence[RecordedFrame]) -> SessionArrays | None:
    """The frames since the last registration, each with its own bone lengths; None if there are none."""
    rotation = setup.calibration.a_from_b.rotation
    last = [frame for frame in frames if frame.fused.a_from_b.rotation is rotation]
    calibration = setup.calibration
    if not last:
        return None
    fixed = calibration.bone_lengths
    lengths = np.array([fixed if frame.bone_lengths is None else frame.bone_lengths for frame in last])
    return SessionArrays.stack(calibration.body, lengths, last)


def session_report(
    setup: FusionSetup,
    frames: Sequence[RecordedFrame],
    sensors: TwoSensors,
    outputs: Sequence[LiveOutput] = (),
) -> Figures:
    """The report of a live session: the figures of ``duplex fuse --report`` and the stream counts.

    Frames are counted since the start. All other figures cover the last minute; ``seconds`` is its actual
    length. Without a fused frame there are only counts.
    """
    counted = sensors.figures
    figures: Figures = {
        "frames": {"a": sensors.a.received, "b": sensors.b.received},
        "paired": counted.pairs,
        "alone": {"a": counted.alone_a, "b": counted.alone_b},
        "dropped": {"a": sensors.a.dropped, "b": sensors.b.dropped + counted.unmatched_b},
        "streams": {
            "too_slow_for": {"a": sensors.a.dropped, "b": sensors.b.dropped},
            "unmatched_b": counted.unmatched_b,
            "late": counted.late,
            "repeated": counted.repeated,
            "out_of_order": counted.reordered,
            "clock_resets": counted.resets,
            "lost_and_back": {"a": sensors.a.returns, "b": sensors.b.returns},
            "clock_offset_ms": None if counted.offset_ns is None else counted.offset_ns * 1e-6,
            "drift_ppm": counted.drift_ppm,
        },
    }
    if outputs:
        figures["outputs"] = [output.figures() for output in outputs]
    links = {side: asdict(link) for side, link in zip("ab", sensors.links, strict=True) if link is not None}
    if links:
        figures["network"] = links
    rows = rows_since_calibration(setup, frames)
    if rows is not None:
        figures["seconds"] = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
        figures |= fusion_figures(setup.calibration, setup.settings, rows)
    return figures | {"latency_ms": latency_figures(frames)}


def latency_figures(frames: Sequence[RecordedFrame]) -> dict[str, float | None]:
    """Milliseconds from the arrival of a pair's first images to S*: median, 99th percentile and largest."""
    known = [frame.latency_ns * 1e-6 for frame in frames if frame.latency_ns is not None]
    if not known:
        return {"p50": None, "p99": None, "max": None}
    return {
        "p50": float(np.median(known)),
        "p99": float(np.percentile(known, 99)),
        "max": float(max(known)),
    }


def save_report(path: Path, figures: Figures) -> None:
    """Writes a report; an unfinished file is never left behind."""
    with whole_file(path) as unfinished:
        unfinished.write_text(report_to_json(figures), encoding="utf-8")


def print_session(
    console: Console,
    setup: FusionSetup,
    frames: Sequence[RecordedFrame],
    sensors: TwoSensors,
    outputs: Sequence[LiveOutput] = (),
    verbose: bool = False,
) -> None:
    """Prints the summary. Frames are counted since the start; the method's figures cover the last minute.

    Args:
        console: Receives the output.
        setup: The last setup.
        frames: The frames of the last minute.
        sensors: The sensors, for their counts.
        outputs: The live outputs, whose counts are printed, too.
        verbose: Whether all figures follow.
    """
    rows = rows_since_calibration(setup, frames)
    figures = None if rows is None else method_figures(rows)
    ms = latency_figures(frames)
    if figures is None:
        console.print("No frame was fused.")
    else:
        print_lines(console, fusion_lines(setup.calibration, figures, ms))
    print_lines(console, _stream_trouble(sensors))
    print_outputs(console, outputs)
    if not verbose:
        return
    print_frames(console, sensors)
    if figures is not None:
        print_method(console, setup.calibration, figures)
    if ms["p50"] is not None:
        console.print(
            f"[bold]From images to S*[/]: {ms['p50']:.0f} ms (median), 99 % {ms['p99']:.0f} ms, max "
            f"{ms['max']:.0f} ms"
        )


def print_saved(console: Console, file: FileSink) -> None:
    """Prints where the session was saved and which frames are missing; nothing if none was to be saved."""
    if file.path is None:
        return
    if file.saved == 0 and file.failure is None:
        console.print(f"{file.path} was not written: no frame was received.", highlight=False, markup=False)
    elif file.failure is None:
        say_saved(console, file.path)
    for count, what in (
        (file.lost, "not saved: the disk was too slow"),
        (file.without_images, "saved without their images: this machine was too slow"),
    ):
        if count:
            console.print(f"[yellow]{count} frames are {what}.[/]", highlight=False)


def check_saved(file: FileSink) -> None:
    """Reports a failure of saving as a usage error: one line and exit code 2.

    Raises:
        UsageError: Saving stopped.
    """
    if file.failure is not None:
        raise UsageError(file.failure)
