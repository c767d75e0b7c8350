"""``duplex fuse``: two recordings in, one session and one report out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fusion.body import Body
from fusion.calibration import Calibration, calibrate, find_start_up_pose
from fusion.errors import CalibrationError
from fusion.fuser import Fuser, FuserSettings
from fusion.skeleton import SkeletonPair
from recordings.arrays import SessionArrays
from recordings.calibration_file import calibration_to_json, read_calibration
from recordings.recorder import Recorder
from viewer_app.blueprint import inspect_blueprint
from viewer_app.errors import UsageError
from viewer_app.options import FuseOptions
from viewer_app.outputs import check_outputs, whole_file
from viewer_app.report import FusionResult, print_summary, report, report_to_json, say_saved
from viewer_app.run import fuse_offline, fuse_one, warm_up
from viewer_app.sinks import open_stream, wants_window
from viewer_app.two_recordings import log_depth, read_two


def run(options: FuseOptions) -> None:
    """Carries out the command.

    Raises:
        DeviceError, FusionError, RecordingError, UsageError: With one line for the person who asked.
    """
    console = Console()
    window = wants_window(options.no_viewer, options.save)
    outputs = (options.save, options.report, options.save_calibration)
    inputs = (options.a, options.b, options.skeletons_a, options.skeletons_b, Path(options.calibrate))
    check_outputs(outputs, filter(None, inputs), options.force)
    settings = FuserSettings(h=options.h, solver=options.solver, weights=options.weights)
    read = read_two(options, console)
    body, pairing = read.body, read.pairing
    for warning in read.warnings:
        console.print(warning, style="yellow", highlight=False, markup=False)
    skeletons = [pair.skeletons for pair in pairing.pairs]
    calibration = _calibrate(options.calibrate, body, skeletons)

    with open_stream(options.save, window, inspect_blueprint(body, _whereabouts(skeletons))) as stream:
        fuser = Fuser(calibration, settings, *read.intrinsics)
        warm_up(fuser, console)
        recorder = Recorder(stream, fuser, (str(options.a), str(options.b)))
        recorder.event(f"calibrated: {calibration.how}")
        for warning in read.warnings:
            recorder.event(warning, "WARN")
        shown = track(
            pairing.pairs, "fusing", console=console, transient=True, disable=not console.is_terminal
        )
        frames = fuse_offline(shown, fuser, recorder)
        if window or options.save is not None:
            log_depth(read, recorder, console)
        recorder.finish()

    rows = SessionArrays.stack(body, calibration.bone_lengths, frames)
    exact = None
    if settings.solver != "exact":
        other = Fuser(calibration, replace(settings, solver="exact"), *read.intrinsics)
        exact = SessionArrays.stack(
            body, calibration.bone_lengths, [fuse_one(other, pair) for pair in pairing.pairs]
        )
    result = FusionResult(pairing, calibration, settings, rows, exact)
    figures = report(result)
    _write(options.report, report_to_json(figures))
    _write(options.save_calibration, calibration_to_json(calibration))
    print_summary(console, result, figures)
    if options.save is not None:
        say_saved(console, options.save)


def _calibrate(wanted: str, body: Body, pairs: Sequence[SkeletonPair]) -> Calibration:
    kind, _, argument = wanted.partition(":")
    if wanted == "auto":
        chosen, how = find_start_up_pose(body, pairs)
        return calibrate(body, chosen, how)
    if kind == "seconds":
        try:
            seconds = float(argument)
        except ValueError:
            seconds = -1.0
        if not 0.0 < seconds < float("inf"):
            raise UsageError(f"--calibrate {wanted}: seconds must be a positive number, as in seconds:3.")
        chosen = [pair for pair in pairs if pair.time_ns - pairs[0].time_ns <= seconds * 1e9]
        return calibrate(body, chosen, f"first {seconds:g} s, {len(chosen)} frames")
    if not Path(wanted).exists():
        raise UsageError(
            f"--calibrate {wanted}: neither auto, nor seconds:N, nor a file that is there. Make one with "
            "--save-calibration."
        )
    return read_calibration(Path(wanted), body)


def _whereabouts(pairs: Sequence[SkeletonPair]) -> NDArray[np.float64]:
    """(3,) metres in K_A's frame, the middle of where the person is over the recording."""
    seen = [pair.a.positions for pair in pairs if pair.a is not None]
    if not seen:
        raise CalibrationError("The principal sensor A never sees the person in a pair.")
    return np.asarray(np.nanmedian(np.concatenate(seen).astype(np.float64), axis=0))


def _write(path: Path | None, text: str) -> None:
    if path is not None:
        with whole_file(path) as partial:
            partial.write_text(text, encoding="utf-8")
