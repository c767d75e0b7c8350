"""``duplex fuse``: fuses two recordings into a session and a report."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from devices.recorded.files import not_of_libk4a
from devices.recorded.two_recordings import RecordingChoice, TwoRecordings
from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate
from fusion.pair_arrays import Pairs
from fusion.setup import FuserSettings
from recordings.calibration_file import calibration_to_json, read_calibration
from recordings.export import export, writer_for
from recordings.fusing.files import fuse_read, read_for, recording_warm_ups
from recordings.quality.figures import Figures, report
from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.options.sensing import FuseOptions, recording_settings
from viewer_app.options.shared import calibration_source
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, export_files, write_text
from viewer_app.report import save_session_report
from viewer_app.report.terminal import print_summary, say_more, say_saved
from viewer_app.running.compilation import warm_up
from viewer_app.viewer.viewer_choice import FileWindow, choose_viewing


def run(options: FuseOptions) -> None:
    """Runs the command."""
    fuse_files(options, output_console())


def fuse_files(options: FuseOptions, console: Console) -> tuple[Session, Figures]:
    """Carries out the command and returns the session and its report."""
    try:
        viewing = choose_viewing(options, options.save, live=False)
    except UsageError:
        if not any(choice.is_tracked for choice in _choices(options)):
            _read(options, FuserSettings(), console)  # a file that cannot be read is the greater fault
        raise
    outputs: list[Path | None] = [options.report, options.save_calibration]
    writer = None if options.to is None else writer_for(options.to)
    if options.to is not None:
        outputs += export_files(options.to)
    check_outputs(outputs, [*_recordings(options), Path(options.calibrate)], options.force, options.save)
    settings = recording_settings(options)
    read = _read(options, settings, console)
    warm_up(console, recording_warm_ups(settings), load=False)
    source, progress = calibration_source(options.calibrate), _progress(console)
    fused = fuse_read(
        read,
        (str(options.a), str(options.b)),
        settings,
        _calibrate(source, read.body, read.pairing.pairs.skeletons, console),
        refine=not (options.no_refine or isinstance(source, Path)),
        depth=options.depth,
        force=options.force,
        progress=progress,
    )
    session = Session.of(*fused)
    del fused  # ends the bar, and frees the labels, 30 bytes of each pair
    figures, kept, about = report(session), session, ""
    if options.good:
        from viewer_app.report.pages.good_part import good_frames_of

        kept = session.part(good_frames_of(session, console))
        about = "These figures are of the whole recordings, of which this session has the good seconds."

    def export_it() -> None:
        if options.to is not None and writer is not None:
            written = export(kept, options.to, writer, options.force)
            console.print(f"Wrote {options.to}: {written}.", markup=False, soft_wrap=True)

    hub, window = viewing.hub, isinstance(viewing, FileWindow)
    if options.save is None and not window and hub is None:
        export_it()
        _summarise(console, options, session, figures)
        viewing.announce(console)
        return session, figures
    from viewer_app.report.pages.session_page import session_page
    from viewer_app.viewer.file_window import served, write_for_viewer, written_and_shown

    def write(path: Path) -> int:
        page = session_page(kept.last_setup, figures, about)
        return write_for_viewer(kept, path, page, active=options.layout, progress=progress)

    shown = written_and_shown(options.save, write, force=options.force, window=window, served=hub is not None)
    with shown as (file, _):
        export_it()  # a session that is saved survives what fails here
        _summarise(console, options, session, figures)
        with served(file, hub) if file is not None and hub is not None else nullcontext():
            viewing.announce(console)
            viewing.stay(console)
    return session, figures


def _read(options: FuseOptions, settings: FuserSettings, console: Console) -> TwoRecordings:
    """Reads both recordings, with a body tracker where they are images, and prints their warnings."""
    choices = _choices(options)
    tracker = None
    if any(choice.is_tracked for choice in choices):
        from viewer_app.sensors.tracker import announce_tracker, tracker_of

        tracker = tracker_of(options).for_images_of(not_of_libk4a(options.a, options.b))
        announce_tracker(tracker, console, *_recordings(options))
    read = read_for(
        settings, choices, tracker, options.offset, _progress(console), options.follow or "longest"
    )
    for warning in read.warnings:
        console.print(warning, style="yellow", markup=False)
    return read


def _recordings(options: FuseOptions) -> list[Path]:
    """The files of both sensors."""
    return list(filter(None, (options.a, options.b, options.skeletons_a, options.skeletons_b)))


def _choices(options: FuseOptions) -> tuple[RecordingChoice, RecordingChoice]:
    turned_a, turned_b = options.orientations
    a = options.a, options.skeletons_a, options.person_a
    b = options.b, options.skeletons_b, options.person_b
    body = "" if options.body == "auto" else options.body
    return (
        RecordingChoice(*a, options.stated_of("a"), "--skeletons-a", "--person-a", body, turned_a),
        RecordingChoice(*b, options.stated_of("b"), "--skeletons-b", "--person-b", body, turned_b),
    )


def _progress(console: Console) -> Callable[..., Any]:
    """Shows the progress of reading and fusing, on a terminal."""
    return partial(track, console=console, transient=True, disable=not console.is_terminal)


def _summarise(console: Console, options: FuseOptions, session: Session, figures: Figures) -> None:
    save_session_report(options.report, figures, session, options.force)
    if options.save_calibration is not None:
        write_text(options.save_calibration, calibration_to_json(session.calibration), options.force)
    told = [event for event in session.events if event.frame > 0]  # the recordings' own are printed already
    print_summary(console, figures, told, options.verbose)
    if options.save is not None:
        say_saved(console, options.save)
    if not options.verbose:
        say_more(console)


def _calibrate(source: Path | float | None, body: Body, pairs: Pairs, console: Console) -> Calibration | None:
    """The calibration that is asked for; None where the recording's start-up pose is to give it."""
    if source is None:
        return None
    if isinstance(source, Path):
        return read_calibration(source, body)
    seconds = (pairs.time_ns - pairs.time_ns[0]) * 1e-9
    chosen, which = pairs[np.flatnonzero(seconds <= source)], f"first {source:g} s"
    if source > seconds[-1] + 1.0:  # not merely rounded up
        which = f"all {seconds[-1]:.1f} s"
        said = f"--calibrate seconds:{source:g}: the recordings are shorter; calibrating on {which}."
        console.print(said, style="yellow", markup=False)
    return calibrate(body, chosen, f"{which}, {len(chosen)} frames")
