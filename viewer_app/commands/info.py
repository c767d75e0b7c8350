"""``duplex info``: what is in a file, whether a session, a recording or motion capture."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.markup import escape
from rich.table import Table

from devices.input_file import check_recording, open_input, reading
from devices.recorded.files import has_images, open_images, recorded_at
from devices.sensor import DeviceError
from devices.skeletons.border import ReadFile
from devices.skeletons.csv_files.text import has_several_sensors
from devices.skeletons.file_sensor import READERS, SkeletonRecording
from devices.skeletons.meaning import MeaningError
from devices.skeletons.name_tables import listed, name_table
from devices.skeletons.stated_format import METRES, OWN_AXES, StatedFormat, called_axes
from recordings.comparing.truth_files import TruthFile, read_truth
from recordings.data import layout
from recordings.data.images import Images
from recordings.data.session_arrays import pauses_of, rate_without_pauses
from recordings.errors import RecordingError
from recordings.quality.figures import calibration_figures
from recordings.session import Session
from viewer_app.options.sessions import InfoOptions
from viewer_app.output_console import output_console
from viewer_app.report.events import list_events
from viewer_app.report.terminal import in_shell, print_events
from viewer_app.report.words import calibration_in_words, in_percent

Rows = Iterator[tuple[str, object]]
_FORMATS = {
    ".csv": "skeletons, as text",
    ".json": "skeletons of Microsoft's offline_processor",
    ".skeleton": "skeletons of NTU RGB+D",
    ".mkv": "images of an Azure Kinect",
    ".bag": "images of Orbbec's SDK v2 or a RealSense",
    ".db3": "images of a RealSense",
    ".c3d": "motion capture",
    ".trc": "motion capture of OpenSim",
    ".tsv": "motion capture of Qualisys",
}
_MOST_PEOPLE = 8


def run(options: InfoOptions) -> None:
    """Runs the command."""
    path, console = options.file, output_console()
    table = Table(show_header=False, box=None)
    suffix = path.suffix.lower()
    check_recording(path)
    if options.names:
        name_table(options.names)  # else the file would be taken for another that has no joints
    other = suffix != ".rrd" and not _begins(path).startswith("'RRF")
    session = None if other else Session.open(path)
    rows = _of_session(session, path) if session is not None else _of_file(path, options.stated)
    try:
        for name, value in rows:
            table.add_row(f"[bold]{name}[/]", escape(str(value)))
    finally:  # of a file that cannot be read, what is known of it
        console.print(table)
    if session is not None and (events := list_events(session.events)):
        print_events(console, events, all_of_them=True)


def _of_file(path: Path, stated: StatedFormat) -> Rows:
    suffix = path.suffix.lower()
    yield "file", f"{path.name}, {path.stat().st_size / 1e3:.0f} kB"
    if suffix not in _FORMATS:
        yield "begins with", _begins(path)
        raise DeviceError(
            f"{path}: {suffix or 'no ending'} is not a format that can be read. "
            f"Known: .rrd, {', '.join(_FORMATS)}. A file in one of these formats needs its ending."
        )
    if has_images(path):
        yield "format", _FORMATS[suffix]
        yield from _of_images(path)
        return
    try:
        if suffix in READERS:
            with SkeletonRecording(path, stated) as recording:
                yield "format", _FORMATS[suffix]
                yield from _of_skeletons(path, recording.content, stated)
            return
        truth = read_truth(path)
    except MeaningError as fault:
        yield from _likely(fault)
        raise
    except (DeviceError, RecordingError) as fault:
        try:
            if suffix != ".csv":
                raise
            truth = read_truth(path)
        except (DeviceError, RecordingError):
            yield "format", f"{_FORMATS[suffix]}; it cannot be read"
            yield "begins with", _begins(path)
            raise fault from None
    yield "format", "motion capture" if suffix in READERS else _FORMATS[suffix]
    yield from _of_motion_capture(path, truth)


def _begins(path: Path) -> str:
    with reading(path, DeviceError, DeviceError), open_input(path) as file:
        return ascii(file.read(60).decode("utf-8", "replace"))


def _of_skeletons(path: Path, read: ReadFile, stated: StatedFormat) -> Rows:
    people, body = read.people, read.body
    states, positions = people.skeletons.states, people.skeletons.positions
    seen = np.array(states.any(axis=0))
    if not seen.any():
        yield "people", "none in any frame"
        yield from _of_times(people.time_ns)
        return
    yield "joints", f"{np.count_nonzero(seen)} of {len(body)} of {body.name}"
    if not seen.all():
        yield "never seen", listed([name for name, there in zip(body.joints, seen, strict=True) if not there])
    shares = [
        f"{in_percent(float(np.mean(states[:, seen] == k)))} {word}"
        for k, word in ((2, "tracked"), (1, "inferred"))
    ]
    yield "states", f"{', '.join(shares)} of these joints"
    counts = np.bincount(people.person, minlength=len(people.ids))
    first = np.argsort(-counts, kind="stable")[:_MOST_PEOPLE]
    named = ", ".join(f"{people.ids[k]!r} in {counts[k]} frames" for k in first)
    yield "people", named + " …" * (len(counts) > _MOST_PEOPLE)
    yield from _of_times(people.time_ns)
    away = np.linalg.norm(positions[:, body.root], axis=1)
    place = (
        f"the person is {np.nanmedian(away):.2f} m away"
        if np.isfinite(away).any()
        else "its root is never seen"
    )
    meaning = read.meaning
    yield "unit", f"{METRES[meaning.unit][1]}; {place}"
    yield "axes", meaning.in_words
    yield from _likely(meaning)
    if read.ignored:
        yield "ignored", f"columns {listed(read.ignored)}"
    for k, line in enumerate(read.warnings):
        yield "" if k else "note", line.removeprefix(f"{path}: ")
    both = path.suffix.lower() == ".csv" and has_several_sensors(path)
    yield _command(path, str(path) if both else "", *_options(read, stated))


def _command(path: Path, other: str = "", *options: str) -> tuple[str, str]:
    words = ["duplex", "fuse", str(path), other or f"OTHER{path.suffix}", *options, "--save", "s.rrd"]
    return "fuse it", in_shell(words)


def _options(read: ReadFile, stated: StatedFormat) -> list[str]:
    """The options that state how the file is read, where that is not the default."""
    unit, axes = read.meaning.unit, read.meaning.axes
    options = {
        "unit": unit if unit != read.unit or stated.unit != "auto" else "",
        "axes": called_axes(axes) if axes != OWN_AXES or stated.axes else "",
        "names": stated.names or read.names,
    }
    return [word for name, value in options.items() if value for word in (f"--{name}-a", value)]


def _likely(of: Any) -> Rows:
    """The hypotheses, the best first, and how much less likely the others are."""
    for question, options in of.table.items():
        yield f"likely {question}", ", ".join(f"{option} {score:.1f}" for option, score in options[:2])


def _of_times(time_ns: NDArray[np.int64]) -> Rows:
    seconds = float(time_ns[-1] - time_ns[0]) * 1e-9
    rate = rate_without_pauses(time_ns)
    yield "frames", f"{len(time_ns)} in {seconds:.2f} s" + (f", {rate:.1f} per second" if rate else "")
    if len(pauses := pauses_of(time_ns)):
        at, longest = max(pauses, key=lambda pause: pause[1])
        counted = "1, of" if len(pauses) == 1 else f"{len(pauses)}, the longest of"
        yield "gaps", f"{counted} {longest:.2f} s at {at:.2f} s"


def _of_images(path: Path) -> Rows:
    with open_images(path) as recording:
        camera = recording.intrinsics
        if recording.sensor:
            yield "sensor", recording.sensor
            yield "recorded", recorded_at(path) or "the file does not say when"
        if camera is not None:
            yield "depth", f"{camera.width} × {camera.height} pixels, focal length {camera.fx:.0f} pixels"
        seconds, rate = recording.duration_ns * 1e-9, 1e9 / recording.interval_ns
        yield "duration", f"{seconds:.2f} s, {rate:.3g} frames per second, as the file states"
        yield "people", "found by a body tracker while the file is fused"
        for k, line in enumerate(recording.warnings):
            yield "" if k else "note", line
    yield _command(path)


def _of_motion_capture(path: Path, truth: TruthFile) -> Rows:
    missing = ~np.isfinite(truth.points).any(axis=(0, 2))
    yield "points", f"{len(truth.labels)}: {listed(truth.labels)}"
    if missing.any():
        yield "never seen", listed([truth.labels[k] for k in np.flatnonzero(missing)])
    yield from _of_times(np.rint(truth.seconds * 1e9).astype(np.int64))
    if truth.warning:
        yield "note", truth.warning.removeprefix(f"{path}: ")
    yield "compare it", f"duplex compare s.rrd {path}"


def _of_session(session: Session, path: Path) -> Rows:
    rows = session.rows
    seconds = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
    size = path.stat().st_size
    about = session.about["session"]
    yield "session", session
    yield "written by", f"{about['written_by'][0]}, layout {about['layout_version'][0]}"
    yield "body", f"{session.body.name}, {len(session.body)} joints"
    yield "sensors", f"A {session.sources[0]}, B {session.sources[1]}"
    if "recorded" in about:
        yield "recorded", about["recorded"][0]
    if session.tracker:
        yield "body tracker", session.tracker
    rate = f"the faster sensor gives {session.frame_rate:.3g} per second"
    yield "frames", f"{len(session)} in {seconds:.2f} s; {rate}"
    if len(people := session.people) > 1:
        yield "people", ", ".join(f"{of.height:.2f} m from {of.seconds[0]:.1f} s" for of in people)
    yield "without S*", int(rows.predicted.all(axis=1).sum())
    yield "settings", ", ".join(f"{k} {v[0]}" for k, v in session.about["settings"].items())
    for k, line in enumerate(session.verdict.sentences):
        yield "" if k else "verdict", line
    for k, line in enumerate(calibration_in_words(calibration_figures(session.calibration))):
        yield "" if k else "calibration", line
    images: dict[str, dict[str, Images[Any]]] = {
        "depth": {side: session.depth(side) for side in layout.VIEWS},
        "colour": {side: session.color(side) for side in layout.VIEWS},
    }
    damage = [session.damage_in_words] if session.damage is not None else []
    for kind, of_sides in images.items():
        counts = {side: reader.count() for side, reader in of_sides.items()}
        if kind == "depth" or any(counts.values()):
            yield f"{kind} images", ", ".join(f"{side.upper()} {count}" for side, count in counts.items())
        damage += [
            f"{reader.damaged} damaged {kind} images of {side.upper()}"
            for side, reader in of_sides.items()
            if reader.damaged
        ]
    a_minute = f", {size / seconds * 60 / 1e6:.1f} MB a minute" if seconds >= 1.0 else ""
    yield "size", f"{size / 1e6:.1f} MB{a_minute}"
    yield "events", len(list_events(session.events))
    yield "whole", f"no: {', '.join(damage)}" if damage else "yes"
