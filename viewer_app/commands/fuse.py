"""``duplex fuse``: two recordings in, one session and one report out."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from fusion.body import Body
from fusion.calibration.calibration import Calibration, calibrate, find_start_up_pose
from fusion.errors import CalibrationError
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.appearance.coach_page import CoachPage
from recordings.calibration_file import calibration_to_json, read_calibration
from recordings.session_arrays import RecordedFrame, SessionArrays
from viewer_app.coach.advice import placement, verdict
from viewer_app.coach.scene import CoachScene
from viewer_app.coach.setup_coach import Situation
from viewer_app.errors import UsageError
from viewer_app.loop.fusing import fuse_offline, fuse_one, warm_up
from viewer_app.loop.recorded_input import log_depth, read_two
from viewer_app.options import FuseOptions
from viewer_app.output_files import check_outputs, whole_file
from viewer_app.report.figures import FusionResult, print_summary, report, report_to_json, say_saved
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.viewer_choice import announce, choose_viewing, stay_for_visitors


def run(options: FuseOptions) -> None:
    """Carries out the command.

    Raises:
        DeviceError, FusionError, RecordingError, UsageError: With one line for the person who asked.
    """
    console = Console()
    viewing = choose_viewing(
        no_viewer=options.no_viewer, web=options.web, listen=options.listen, save=options.save, live=False
    )
    outputs = (options.save, options.report, options.save_calibration)
    inputs = (options.a, options.b, options.skeletons_a, options.skeletons_b, Path(options.calibrate))
    check_outputs(outputs, filter(None, inputs), options.force)
    settings = FuserSettings(options.method, options.h, options.weights, options.smoothing)
    read = read_two(options, console)
    body, pairing = read.body, read.pairing
    for warning in read.warnings:
        console.print(warning, style="yellow", highlight=False, markup=False)
    skeletons = [pair.skeletons for pair in pairing.pairs]
    calibration = _calibrate(options.calibrate, body, skeletons)

    setup = FusionSetup(calibration, settings, *read.cameras(options.depth))
    fuser = Fuser(setup)
    warm_up(fuser, console)
    blueprint = session_blueprint(setup, _whereabouts(skeletons), options.layout)
    with ExitStack() as viewer:
        announce(viewing, console)
        with ExitStack() as file:
            session = viewer.enter_context(
                LiveSession(
                    setup,
                    (str(options.a), str(options.b)),
                    blueprint,
                    file=None if options.save is None else file.enter_context(whole_file(options.save)),
                    viewing=viewing,
                    complete=True,
                )
            )
            session.event(f"calibrated: {calibration.how}")
            session.coach(_verdict(setup))
            shown = track(
                pairing.pairs, "fusing", console=console, transient=True, disable=not console.is_terminal
            )
            for warning in read.warnings:
                session.event(warning, "WARN")
            frames = fuse_offline(shown, fuser, session)
            log_depth(read, session, options.depth, console)
            session.finish()
            session.save()
        _summarise(console, options, FusionResult(pairing, calibration, settings, *_rows(frames, setup)))
        stay_for_visitors(viewing, console)


def _verdict(setup: FusionSetup) -> CoachPage:
    """What the setup says of a recording: how well its two views fit, and what would have been better."""
    calibration = setup.calibration
    scene = CoachScene(setup.body, setup.intrinsics)
    advice = list(placement(calibration)) or [verdict(calibration)]
    return scene.page(advice, Situation(calibration, settled=True, held=0.0))


def _rows(frames: list[RecordedFrame], setup: FusionSetup) -> tuple[SessionArrays, SessionArrays | None]:
    """What was fused, and the same with exact bones where the published scheme was asked for."""
    calibration = setup.calibration
    rows = SessionArrays.stack(calibration.body, calibration.bone_lengths, frames)
    if setup.settings.method != "published":
        return rows, None
    settings = replace(setup.settings, method="paper")
    other = Fuser(FusionSetup(calibration, settings, *setup.intrinsics))
    again = [fuse_one(other, frame.pair) for frame in frames]
    return rows, SessionArrays.stack(calibration.body, calibration.bone_lengths, again)


def _summarise(console: Console, options: FuseOptions, result: FusionResult) -> None:
    figures = report(result)
    _write(options.report, report_to_json(figures))
    _write(options.save_calibration, calibration_to_json(result.calibration))
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
