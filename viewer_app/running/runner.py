"""What ``duplex live`` and ``duplex demo`` have in common: from open sensors to the summary at the end."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from rich.console import Console

from devices.capture.sensor_pair import TwoSensors
from devices.recorded.files import images_of, recorded_at
from devices.sensor import ImageRecording, Sensor
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionArrays, SessionFrame
from recordings.quality.figures import Figures, fusion_figures, with_verdict
from recordings.session import Session
from viewer_app.coach.setup_coach import Coach
from viewer_app.errors import UsageError
from viewer_app.options.sensing import DemoOptions, LiveOptions
from viewer_app.output_files import save_report, warn_of_little_room
from viewer_app.outputs.opening import announce_outputs, check_kept, plan_outputs, print_outputs
from viewer_app.outputs.output import LiveOutput
from viewer_app.report.terminal import print_details, print_summary, say_more, say_saved
from viewer_app.report.walking import gait_figures
from viewer_app.running.interruption import call_after
from viewer_app.running.sounds import Sounds, player
from viewer_app.running.status import LiveDisplay
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.viewer_choice import choose_viewing

_REVIEWED = 18_000
"""Frames of the longest session that is read again for its summary: 100 MB."""


class Runner:
    """Opens the sinks of a session whose sensors run, and prints its summary.

    Attributes:
        session: The sinks; set by :meth:`open_session`.
    """

    session: LiveSession

    def __init__(
        self,
        options: DemoOptions | LiveOptions,
        console: Console,
        save: Path | None,
        remote_sensors: bool = False,
    ) -> None:
        self.viewing = choose_viewing(options, save, live=True, served=options.listens)
        self._plan = plan_outputs(options, options.listen, remote_sensors, options.force)
        self._options, self._console, self._save = options, console, save
        self._outputs: Sequence[LiveOutput] = ()

    def open_outputs(self, stack: ExitStack, setup: FusionSetup, rate: float) -> None:
        """Opens the outputs to other programs, for a nominal frame rate; the stack closes them."""
        self._outputs = stack.enter_context(self._plan.opened(setup, rate))
        announce_outputs(self._console, self._outputs)

    def open_session(
        self,
        stack: ExitStack,
        sensors: TwoSensors,
        setup: FusionSetup,
        coach: Coach,
        blueprint: Callable[..., rrb.Blueprint],
        infrared: bool = False,
        reframes: bool = False,
    ) -> LiveDisplay:
        """Opens viewer, file and status line, which the stack closes; returns the observer of the loop.

        Args:
            blueprint: Makes the layout of a setup; takes ``infrared`` and ``card``.
            infrared: Whether the viewer gets infrared images; a file has none.
            reframes: Whether the layout is made anew once it is known where B stands.
        """
        console, options, a, b = self._console, self._options, sensors.a.sensor, sensors.b.sensor
        if self._save is not None:
            warn_of_little_room(self._save, console)
        shown = partial(blueprint, infrared=infrared, card=True)
        self.session = stack.enter_context(
            LiveSession(
                setup,
                (a.name, b.name),
                shown(setup),
                file=self._save,
                overwrite=options.force,
                viewing=self.viewing,
                file_blueprint=blueprint(setup, infrared=False),
                reframed=shown if reframes else None,
                others=self._outputs,
                about={
                    name: value
                    for name, value in (("recorded", _recorded(a)), ("tracker", a.tracked_by))
                    if value
                },
            )
        )
        self.viewing.announce(console)
        sounds = self._sounds(stack) if options.sound else None
        display = LiveDisplay(console, self.session, coach, options.quiet, options.verbose, sounds)
        return stack.enter_context(display)

    def _sounds(self, stack: ExitStack) -> Sounds | None:
        play = player()
        if play is None:
            self._console.print(
                "No sound: there is neither paplay nor pw-play nor aplay. Install pulseaudio-utils or "
                "alsa-utils."
            )
            return None
        return stack.enter_context(Sounds(play))

    def summarise(self, setup: FusionSetup, frames: Sequence[SessionFrame], sensors: TwoSensors) -> None:
        """Prints the figures of the session, and writes them if that is wanted.

        Frames are counted since the start. The method's figures are those of ``duplex review`` where the
        session is saved, else they cover the last minute, as those of sessions above ten minutes do.
        """
        console, verbose, file = self._console, self._options.verbose, self.session.file
        saved = None
        with call_after(1.0, lambda: console.print("Computing the summary …")):
            if file is not None and file.failure is None and 0 < file.written <= _REVIEWED:
                saved = Session.open(file.path)
            figures = session_report(setup, frames, sensors, self._outputs, saved)
        if "fused_frames" not in figures:
            console.print("No frame was fused.")
        print_summary(console, figures)
        print_outputs(console, self._outputs)
        if verbose:
            print_details(console, figures)
        if self._options.report is not None:
            gait = None if saved is None else gait_figures(saved.gait)
            save_report(self._options.report, figures | {"gait": gait}, self._options.force)

    def print_end(self) -> None:
        """Prints where the session was saved, which frames are missing, and where all figures are."""
        console, file = self._console, self.session.file
        if file is not None:
            if file.written and file.failure is None:
                say_saved(console, file.path)
            for text in file.missing:
                console.print(text, style="yellow", markup=False, soft_wrap=True)
        if not self._options.verbose:
            say_more(console)

    def check_saved(self) -> None:
        """Reports a file that is not whole as a usage error: one line and exit code 2."""
        file = self.session.file
        if file is not None and file.failure is not None:
            raise UsageError(file.failure)
        check_kept(self._outputs)


def rows_of(setup: FusionSetup, frames: Sequence[SessionFrame]) -> SessionArrays | None:
    """The frames, each with the bone lengths that it was fused with; None if there are none."""
    if not frames:
        return None
    fixed = setup.calibration.bone_lengths
    lengths = np.array([fixed if frame.bone_lengths is None else frame.bone_lengths for frame in frames])
    return SessionArrays.stack(setup.body, lengths, frames)


def session_report(
    setup: FusionSetup,
    frames: Sequence[SessionFrame],
    sensors: TwoSensors,
    outputs: Sequence[LiveOutput] = (),
    session: Session | None = None,
) -> Figures:
    """The report of a live session: the figures of ``duplex fuse --report`` and the stream counts.

    Frames are counted since the start. All other figures cover the whole session where it is given, as
    in ``duplex review``, else the frames; ``seconds`` is their length. Without a fused frame there are only
    counts.
    """
    figures = stream_figures(sensors)
    if outputs:
        figures["outputs"] = [output.figures() for output in outputs]
    figures["latency_ms"] = latency_figures(frames)
    figures["others_seen"] = others_seen(frames)
    rows = rows_of(setup, frames) if session is None else session.rows
    if rows is None:
        return figures
    if session is not None:
        setup = session.last_setup
    # else the newest frames only, which are seldom older than the calibration
    first = 0 if session is None else session.first_compared_frame
    return with_verdict(figures | fusion_figures(setup, rows, first))


def stream_figures(sensors: TwoSensors) -> Figures:
    """What became of the frames of both sensors, and the state of the links to other PCs."""
    counted, a, b = sensors.figures, sensors.a, sensors.b
    figures: Figures = {
        "frames": {"a": a.received, "b": b.received},
        "paired": counted.pairs,
        "alone": {"a": counted.alone_a, "b": counted.alone_b},
        "dropped": {"a": a.dropped, "b": b.dropped + counted.unmatched_b},
        "streams": {
            "too_slow_for": {"a": a.dropped, "b": b.dropped},
            "lost_on_usb": {"a": a.lost, "b": b.lost},
            "unmatched_b": counted.unmatched_b,
            "late": counted.late,
            "repeated": counted.repeated,
            "out_of_order": counted.reordered,
            "clock_resets": counted.resets,
            "lost_and_back": {"a": a.returns, "b": b.returns},
            "clock_offset_ms": None if counted.offset_ns is None else counted.offset_ns * 1e-6,
            "drift_ppm": counted.drift_ppm,
        },
    }
    links = {side: asdict(link) for side, link in zip("ab", sensors.links, strict=True) if link is not None}
    return figures | ({"network": links} if links else {})


def others_seen(frames: Sequence[SessionFrame]) -> float:
    """The share of frames in which a sensor sees somebody besides the person followed."""
    seen = 0
    for pair in (frame.pair for frame in frames):
        views = (pair.a, pair.skeletons.a), (pair.b, pair.skeletons.b)
        seen += any(view is not None and len(view.people) > (one is not None) for view, one in views)
    return seen / len(frames) if frames else 0.0


def latency_figures(frames: Sequence[SessionFrame]) -> dict[str, float | None]:
    """Milliseconds from the arrival of a pair's first images to S*: median, 99th percentile and largest."""
    known = [frame.latency_ns * 1e-6 for frame in frames if frame.latency_ns is not None]
    if not known:
        return {"p50": None, "p99": None, "max": None}
    return {"p50": float(np.median(known)), "p99": float(np.percentile(known, 99)), "max": float(max(known))}


def _recorded(sensor: Sensor) -> str:
    """When its frames are or were captured, ISO 8601; empty where a recording does not say."""
    images = images_of(sensor)
    if isinstance(images, ImageRecording):
        return recorded_at(images.path)
    return datetime.now(UTC).isoformat(timespec="milliseconds")
