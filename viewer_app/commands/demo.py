"""``duplex demo``: runs two simulated Kinects in real time through the loop of the real sensors."""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.markup import escape

from devices.capture.sensor_pair import TwoSensors
from devices.output_file import free_name
from devices.simulated.demonstration import (
    BAD_ANGLE_DEG,
    Demonstration,
    HardMoment,
    demonstrated,
    demonstration,
    therapist,
)
from devices.simulated.kinect import (
    Scene,
    SimulatedKinect,
    Truth,
    TruthAhead,
    compile_images,
    compile_tracking,
)
from devices.simulated.person.movements import MOTIONS
from devices.simulated.real_time import paced_together
from fusion.body import BLAZEPOSE, BODIES
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionArrays, SessionFrame
from viewer_app.coach.setup_coach import Coach
from viewer_app.errors import UsageError
from viewer_app.options.sensing import DemoOptions
from viewer_app.options.shared import check_seconds
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs
from viewer_app.report.terminal import figure_table, print_lines
from viewer_app.report.words import Line
from viewer_app.running.loop import run_live
from viewer_app.running.runner import Runner
from viewer_app.running.status import LiveDisplay
from viewer_app.sensors.raw_files import RawFiles
from viewer_app.viewer.display import has_display

if TYPE_CHECKING:
    from devices.blazepose.pace import TrackingPace

_SAVED_WITHOUT_DISPLAY = Path("demo.rrd")
_MB_PER_SECOND = {"half": 4, "full": 12}  # of depth images; those of Azure Kinects are the largest
_FPS = 30.0
_EXCHANGED = 10.0  # ids of two people, times a minute
_MOST_NAMED = 4  # times of one fault
_NEXT = "Next: {walk}{other}, or your own sensors (duplex doctor)."


def run(options: DemoOptions) -> None:
    """Runs the command."""
    console = output_console()
    if options.motion == "list":
        console.print("\n".join(MOTIONS))
        return
    check_seconds(options.seconds)
    save = options.save
    if save is None and not (options.no_viewer or options.web or has_display()):
        save = free_name(_SAVED_WITHOUT_DISPLAY)
    demo = _Demo(options, console, save)
    check_outputs([options.report, options.save_mcap], [], options.force, save)
    _check(options)
    own_tracker = options.tracker == "blazepose"
    body = BLAZEPOSE if own_tracker else BODIES[options.body]
    shown = demonstration(
        Scene(
            demonstrated(options.motion),
            body,
            seconds=options.seconds,
            seed=options.seed,
            other=therapist(options.other) if options.people > 1 else None,
            exchanged=_EXCHANGED,
        ),
        angle_deg=options.angle,
        depth=options.depth,
        infrared=own_tracker or options.record is not None,
        bad_setup=options.bad_setup,
    )
    pace = _own_tracker(options, console) if own_tracker else None
    if save is not options.save and options.depth != "none":
        console.print(
            f"Saving to {save}, {_MB_PER_SECOND[options.depth]} MB per second; much less with --depth none."
        )
    demo.show(shown, pace, RawFiles(options.record, console, force=options.force, compress=options.compress))


def _check(options: DemoOptions) -> None:
    """Rejects options that contradict each other."""
    own_tracker = options.tracker == "blazepose"
    if own_tracker and options.body not in ("azure_kinect", "blazepose"):
        raise UsageError(f"--tracker blazepose reports the body blazepose, not {options.body}.")
    if own_tracker and options.depth == "none":
        raise UsageError("--tracker blazepose needs images: give --depth half or full.")
    if options.record is not None and options.depth == "none":
        raise UsageError("--record needs images: give --depth half or full.")
    if options.bad_setup and options.angle != DemoOptions.angle:
        raise UsageError(f"--bad-setup has its own angle, {BAD_ANGLE_DEG:.0f}°: leave --angle out.")


class _Demo(Runner):
    """Fuses the simulated sensors until they end or Ctrl-C is pressed; saves and prints the summary."""

    options: DemoOptions

    def show(self, shown: Demonstration, pace: TrackingPace | None, raw: RawFiles) -> None:
        a, b = shown.a, shown.b
        self.active = "setup" if self.options.bad_setup else self.options.layout
        self.shown, self.person_at = shown, np.asarray(shown.truth.positions_at(0).mean(axis=0))
        self.setup = FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
        self.coach = Coach(a.body, self.setup.intrinsics, origins=("simulation", "simulation"))
        self.warm_ups = [compile_tracking, *([] if self.options.depth == "none" else [compile_images])]
        if pace is not None:
            self.console.print(
                "The program's own body tracker (BlazePose) runs on simulated infrared and depth images."
            )
        _introduce(self.console, self.options, shown.moments if pace is None else ())
        self.run(_together(a, b, pace), raw)

    def begin(self, stack: ExitStack) -> None:
        """Opens the sensors: their time starts at once."""
        self.open_sensors(stack, announced=False)

    def loop(self, display: LiveDisplay) -> None:
        truth_at = TruthAhead(self.shown.truth)
        self.setup, self.frames = run_live(
            self.sensors, self.setup, self.session, truth_at=truth_at, go_on=display
        )
        self.session.save()
        with suppress(KeyboardInterrupt):  # after Ctrl-C, do not wait for another one
            again = threading.Event()
            self.ctrl_c.calls(again.set)
            self.viewing.stay(self.console, again)

    def tell_more(self) -> None:
        a, b = self.shown.a, self.shown.b
        left_out, wanted = a.images_left_out + b.images_left_out, a.images_wanted + b.images_wanted
        if left_out:
            self.console.print(
                f"To keep pace, {left_out} of {wanted} depth images were dropped; use a smaller --depth."
            )
        if self.frames:
            _print_truth(self.console, self.setup, self.frames, self.shown.truth, self.options.verbose)

    def end(self) -> None:
        if not self.options.quiet:
            other = "the demo without --bad-setup" if self.options.bad_setup else "--bad-setup"
            walk = "" if self.options.motion == "walk" else "--motion walk, "
            self.console.print(_NEXT.format(walk=walk, other=other))
        super().end()


def _introduce(console: Console, options: DemoOptions, moments: Sequence[HardMoment]) -> None:
    """Prints what happens, and when to look."""
    angle = BAD_ANGLE_DEG if options.bad_setup else options.angle
    does = {"walks": "walks about", "sits": "sits down in front of them"}[options.other]
    beside = f" and another one who {does}" if options.people > 1 else ""
    console.print(
        f"A simulated person ({escape(options.motion)}){beside} in front of two Kinects {angle:.0f}° apart, "
        f"{options.seconds:g} s. Press Ctrl-C to end."
    )
    if options.quiet:
        return
    if options.bad_setup:
        console.print(
            "The sensors are badly placed, and S* is less accurate. The advice says what to change."
        )
    for moment in sorted(moments, key=lambda each: each.starts[0]):
        when = ", ".join(f"{start:g}" for start in moment.starts[:_MOST_NAMED])
        when += " …" if len(moment.starts) > _MOST_NAMED else ""
        console.print(f"At {when} s {moment.fault} for a second; S* stays correct.")


def _own_tracker(options: DemoOptions, console: Console) -> TrackingPace:
    """Fetches the networks of the program's own tracker if needed, and returns its pace."""
    from devices.blazepose.pace import TrackingPace
    from devices.blazepose.settings import BlazePoseSettings
    from viewer_app.sensors.tracker import ensure_networks

    settings = BlazePoseSettings(options.tracker_network, options.tracker_model)
    ensure_networks(settings, console)
    return TrackingPace(_FPS, settings, simulated=True)


def _together(a: SimulatedKinect, b: SimulatedKinect, pace: TrackingPace | None) -> TwoSensors:
    """Both sensors in real time, with their own simulated trackers or with the program's own."""
    if pace is None:
        return TwoSensors(*paced_together(a, b))
    from devices.blazepose.tracked_images import TrackedImages

    images = paced_together(a, b, decimation=pace)
    tracked = [TrackedImages(sensor, pace.settings, pace=pace) for sensor in images]
    return TwoSensors(*tracked, decimation=pace)


def _print_truth(
    console: Console, setup: FusionSetup, frames: Sequence[SessionFrame], truth: Truth, verbose: bool
) -> None:
    rows = SessionArrays.stack(setup.body, setup.calibration.bone_lengths, frames)
    assert rows.truth is not None
    angle = math.degrees(setup.calibration.a_from_b.angle_to(truth.a_from_b))
    calibrated = rows.frame >= len(rows) // 4  # the start-up pose is over by then
    a_mm, b_mm, fused_mm = (
        np.linalg.norm(positions - rows.truth, axis=2)[calibrated] * 1e3
        for positions in (rows.positions_a, rows.b_in_a, rows.fused)
    )
    # a view is compared where it reports a joint; S* also has the joints that no sensor sees
    compared = [
        (joints, name, off[seen], fused_mm[seen])
        for joints, name, off in (("that A reports", "S_A", a_mm), ("that B reports", "S_B", b_mm))
        for seen in [np.isfinite(off) & np.isfinite(fused_mm)]
        if seen.any()
    ]
    if not compared:
        return
    each = [
        f"{joints}: {name} {off.mean():.0f} mm, S* {at.mean():.0f} mm" for joints, name, off, at in compared
    ]
    every = fused_mm[np.isfinite(fused_mm)]
    text = f"mean distance of the joints {'; '.join(each)}; all: S* {every.mean():.0f} mm."
    print_lines(console, [Line("Truth", text)])
    if not verbose:
        return
    console.print(f"The sensors' true rotation lies {angle:.1f}° from the one found.")
    table = [
        [joints, name, f"{values.mean():.0f} mm", f"{np.percentile(values, 95):.0f} mm"]
        for joints, view, off, at in [*compared, ("all", "S*", every, every)]
        for name, values in ((view, off), ("S*", at))[joints == "all" :]
    ]
    title = "Distance from the true joints, after the start"
    console.print(figure_table(title, ("joints", "skeleton", "mean", "95 %"), table))
