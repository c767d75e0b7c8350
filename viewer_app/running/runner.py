"""What ``duplex live`` and ``duplex demo`` have in common: from open sensors to the summary at the end."""

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from devices.capture.causes import origin_of
from devices.capture.sensor_pair import TwoSensors
from devices.recorded.files import images_of, recorded_at
from devices.sensor import ImageRecording, Sensor
from fusion.compiling.kernels import WarmUp
from fusion.setup import FusionSetup
from recordings.data.session_arrays import SessionArrays, SessionFrame
from recordings.live_fusion import live_warm_ups
from recordings.quality.figures import Figures, fusion_figures, with_verdict
from recordings.session import Session
from viewer_app.coach.setup_coach import Coach
from viewer_app.errors import UsageError
from viewer_app.options.sensing import DemoOptions, LiveOptions
from viewer_app.output_files import warn_of_little_room
from viewer_app.outputs.opening import announce_outputs, check_kept, plan_outputs, print_outputs
from viewer_app.report import save_session_report
from viewer_app.report.terminal import print_details, print_summary, say_more, say_saved
from viewer_app.running.compilation import first_run
from viewer_app.running.interruption import call_after
from viewer_app.running.sensor_run import SensorRun
from viewer_app.running.sounds import Sounds, player
from viewer_app.running.status import LiveDisplay
from viewer_app.sinks.live_session import LiveSession
from viewer_app.viewer.blueprint import Layout, session_blueprint
from viewer_app.viewer.viewer_choice import choose_viewing

_REVIEWED = 18_000
"""Frames of the longest session that is read again for its summary: 100 MB."""


class Runner(SensorRun):
    """A run whose frames are fused, shown and saved.

    A subclass sets `setup`, the one at the start, and what the viewer shows: the layout `active`, and
    `person_at`, (3,) metres in K_A's frame. It leaves the last setup and :func:`run_live`'s `frames`.
    """

    options: DemoOptions | LiveOptions
    session: LiveSession
    setup: FusionSetup
    frames: Sequence[SessionFrame]
    coach: Coach
    active: Layout
    person_at: NDArray[np.float64]
    warm_up = 0.0  # seconds until the sensors' distances are stable
    warm_ups: Sequence[WarmUp] = ()
    """What it needs besides what every live run does."""

    def __init__(
        self, options: DemoOptions | LiveOptions, console: Console, save: Path | None, remote: bool = False
    ) -> None:
        super().__init__(options, console)
        self.viewing = choose_viewing(options, save, live=True, served=options.listens)
        self._plan = plan_outputs(options, options.listen, remote, options.force)
        self._save = save

    def work(self, stack: ExitStack) -> None:
        """Compiles kernels on a first run while outputs, sensors and viewer open; then fuses."""
        shares = live_warm_ups(self.setup.settings.method, *self.warm_ups)
        with first_run(self.console, shares) as running:
            self.open_outputs(stack)
            display = self.open_session(stack, sample=bool(running))
            with self.ctrl_c.raising():
                running.finish()
        self.begin(stack)
        self.session.begin()
        self.loop(stack.enter_context(display))

    def begin(self, stack: ExitStack) -> None:
        """Called when all is compiled, before the first frame."""

    def loop(self, display: LiveDisplay) -> None:
        """Fuses until the sensors end."""
        raise NotImplementedError

    def open_outputs(self, stack: ExitStack) -> None:
        """Opens the outputs to other programs, which the stack closes."""
        self._outputs = stack.enter_context(self._plan.opened(self.setup, self.sensors.rate))
        if self._save is None:
            for output in self._outputs:
                output.allow_requests()
        announce_outputs(self.console, self._outputs)

    def open_session(self, stack: ExitStack, sample: bool = False) -> LiveDisplay:
        """Opens viewer and file, which the stack closes; returns the observer of the loop, for the stack.

        Args:
            sample: Whether the viewer shows a recorded sample until the session begins.
        """
        console, options, a, b = self.console, self.options, self.sensors.a.sensor, self.sensors.b.sensor
        if self._save is not None:
            warn_of_little_room(self._save, console)
        depth = options.depth != "none"
        layout = partial(
            session_blueprint,
            person_at=self.person_at,
            active=self.active,
            live=True,
            depth=depth,
            color=getattr(options, "color", "off") != "off",
        )
        # of both sensors, on which the program's own tracker works; a file has none
        infrared = depth and all(each.tracked_by.startswith("blazepose") for each in (a, b))
        shown = partial(layout, infrared=infrared, card=True)
        self.session = stack.enter_context(
            LiveSession(
                self.setup,
                (a.name, b.name),
                shown(self.setup),
                file=self._save,
                requests=next((each for output in self._outputs if (each := output.requests)), None),
                overwrite=options.force,
                viewing=self.viewing,
                sample=sample,
                file_blueprint=layout(self.setup),
                reframed=shown if self.active == "setup" else None,  # once it is known where B stands
                others=self._outputs,
                about=lambda: {name: value for name, value in _about(a).items() if value},
            )
        )
        self.viewing.announce(console)
        sounds = self._sounds(stack) if options.sound else None
        return LiveDisplay(
            *(console, self.session, self.coach, options.quiet, options.verbose, sounds), warm_up=self.warm_up
        )

    def _sounds(self, stack: ExitStack) -> Sounds | None:
        play = player()
        if play is None:
            self.console.print(
                "No sound: there is neither paplay nor pw-play nor aplay. Install pulseaudio-utils or "
                "alsa-utils."
            )
            return None
        return stack.enter_context(Sounds(play))

    def tell(self) -> None:
        """Prints and writes the figures of the session, where it is saved, and what is missing.

        Frames are counted since the start. The method's figures are those of ``duplex review`` where the
        session is saved, else they cover the last minute, as those of sessions above ten minutes do.
        """
        console, verbose, file = self.console, self.options.verbose, self.session.file
        saved = None
        with call_after(1.0, lambda: console.print("Computing the summary …")):
            if file is not None and file.failure is None and 0 < file.written <= _REVIEWED:
                saved = Session.open(file.path)
            figures = self._figures(saved)
        if "fused_frames" not in figures:
            console.print("No frame was fused.")
        print_summary(console, figures)
        print_outputs(console, self._outputs)
        if verbose:
            print_details(console, figures)
        save_session_report(self.options.report, figures, saved, self.options.force)
        self.tell_more()
        for each in self.session.files:
            if each.written and each.failure is None:
                say_saved(console, each.path)
            for text in each.missing:
                console.print(text, style="yellow", markup=False, soft_wrap=True)
        if not verbose:
            say_more(console)

    def _figures(self, session: Session | None) -> Figures:
        """The report: the figures of ``duplex fuse --report`` and the stream counts.

        Frames are counted since the start. All other figures cover the whole session where it is given, as
        in ``duplex review``, else the frames; ``seconds`` is their length. Without a fused frame there are
        only counts.
        """
        setup, frames, figures = self.setup, self.frames, stream_figures(self.sensors)
        if self._outputs:
            figures["outputs"] = [output.figures() for output in self._outputs]
        figures |= {"latency_ms": latency_figures(frames), "others_seen": others_seen(frames)}
        figures["of_the_last_s"] = None
        if session is not None:
            setup, rows, first = session.last_setup, session.rows, session.first_compared_frame
        elif frames:  # the newest only, which are seldom older than the calibration
            fixed = setup.calibration.bone_lengths
            lengths = [fixed if frame.bone_lengths is None else frame.bone_lengths for frame in frames]
            rows, first = SessionArrays.stack(setup.body, np.array(lengths), frames), 0
            if len(frames) < self.sensors.figures.pairs:
                figures["of_the_last_s"] = float(rows.time_ns[-1] - rows.time_ns[0]) * 1e-9
        else:
            return figures
        return with_verdict(figures | fusion_figures(setup, rows, first))

    def tell_more(self) -> None:
        """Prints what follows the figures."""

    def end(self) -> None:
        for file in self.session.files:
            if file.failure is not None:
                raise UsageError(file.failure)
        check_kept(self._outputs)


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
            "origins": {"a": origin_of(a.sensor), "b": origin_of(b.sensor)},
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


def _about(sensor: Sensor) -> dict[str, str]:
    """What a session keeps of its sensors."""
    return {"recorded": _recorded(sensor), "tracker": sensor.tracked_by}


def _recorded(sensor: Sensor) -> str:
    """When its frames are or were captured, ISO 8601; empty where a recording does not say."""
    images = images_of(sensor)
    if isinstance(images, ImageRecording):
        return recorded_at(images.path)
    return datetime.now(UTC).isoformat(timespec="milliseconds")
