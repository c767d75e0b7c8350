"""The terminal output of a running loop: a status line and the coach's advice."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.markup import escape
from rich.text import Text

from devices.events import Event
from devices.findings.finding import Finding, capital
from devices.findings.rules import RULES
from fusion.calibration.calibration import Calibration
from recordings.appearance.coach_page import CoachPage
from recordings.quality.figures import calibration_figures
from viewer_app.coach.readiness import Readiness
from viewer_app.coach.scene import CoachScene
from viewer_app.coach.setup_coach import Coach, Situation
from viewer_app.flags import in_flags
from viewer_app.report.words import precision_in_words
from viewer_app.running.loop import Status
from viewer_app.running.sounds import Sounds
from viewer_app.sinks.live_session import LiveSession

_EVERY = 0.5  # seconds between two status lines; a person cannot read them faster
_OVER_AFTER_NS = 2_000_000_000  # without a problem until it counts as ended
_SAID_AGAIN_NS = 30_000_000_000
_RATE_OVER = 2.0  # seconds over which the frame rate is averaged


class LiveDisplay:
    """Callback for each :class:`~viewer_app.running.loop.Status`; always returns True.

    Args:
        session: Receives the coach's page; provides the counts of saved and dropped frames.
        quiet: Print no status line and no advice, which the session keeps as events; what fails is printed.
        verbose: Keep every status line, with more figures.
        sounds: Plays the tones of the set-up; None: none.
        warm_up: Seconds until the sensors' distances are stable.
    """

    def __init__(
        self,
        console: Console,
        session: LiveSession,
        coach: Coach,
        quiet: bool = False,
        verbose: bool = False,
        sounds: Sounds | None = None,
        clock: Callable[[], float] = time.monotonic,
        warm_up: float = 0.0,
    ) -> None:
        self._console, self._session, self._coach = console, session, coach
        self._quiet, self._verbose, self._sounds, self._clock = quiet, verbose, sounds, clock
        self._live = Live(console=console, auto_refresh=False, transient=True)
        self._shows = not quiet and not verbose and console.is_terminal
        self._warm_up_min, self._began_ns = warm_up / 60.0, 0
        self._said: dict[str, tuple[str, int]] = {}  # by topic: what was said, and when it was last so
        self._printed: dict[str, int] = {}  # by topic: when, ns
        self._scene = CoachScene(coach.body, coach.intrinsics)
        self._readiness = Readiness()
        self._page: CoachPage | None = None
        self._failures_told: set[str] = set()
        self._frames: deque[Status] = deque()
        self._next = -np.inf

    def __enter__(self) -> LiveDisplay:
        if self._shows:
            self._live.start()
        return self

    def __exit__(self, *exc_info: object) -> None:
        if self._shows:
            self._live.stop()

    def __call__(self, status: Status) -> bool:
        newest = status.frame.pair.time_ns
        self._began_ns = self._began_ns or newest
        self._frames.append(status)
        while newest - self._frames[0].frame.pair.time_ns > _RATE_OVER * 1e9:
            self._frames.popleft()
        self._advise(status)
        for event in status.events:
            self._console.print(event.text, style="yellow", markup=False, soft_wrap=True)
        viewer = self._session.viewer
        failures = [file.failure or file.waited for file in self._session.files]
        for failure in (*failures, viewer and viewer.window_failure):
            if failure and failure not in self._failures_told:
                self._failures_told.add(failure)
                self._console.print(f"[bold red]{escape(failure)}[/] The fusion continues.", soft_wrap=True)
        now = self._clock()
        if now >= self._next:
            self._next = now + _EVERY
            line = self.line()
            if self._shows:
                self._live.update(Text(line, no_wrap=True, overflow="ellipsis"), refresh=True)
            elif self._verbose:
                self._console.print(line, markup=False, soft_wrap=True)
        return True

    def line(self) -> str:
        """The status line: fps A/B, skew, trust A/B, fuse µs, saving MB."""
        frames = [status.frame for status in self._frames]
        span = max((frames[-1].pair.time_ns - frames[0].pair.time_ns) * 1e-9, 1e-3)
        rates = [sum(getattr(f.pair, side) is not None for f in frames[1:]) / span for side in "ab"]
        weights = np.array([[f.fused.weights_a.mean(), f.fused.weights_b.mean()] for f in frames])
        trust = weights.mean(axis=0)
        skew = np.median([abs(f.pair.skew_ns) for f in frames]) * 1e-6
        fuse = np.median([f.fuse_ns for f in frames]) * 1e-3
        parts = [
            f"fps {rates[0]:.0f}/{rates[1]:.0f}",
            f"skew {skew:.1f} ms",
            f"trust {trust[0]:.2f}/{trust[1]:.2f}",
            f"fuse {fuse:.0f} µs",
        ]
        file, viewer = self._session.open_file, self._session.viewer
        if file is not None:
            stopped = file.failure is not None
            parts.append("SAVING STOPPED" if stopped else f"saving {file.written_bytes / 1e6:.1f} MB")
        if viewer is not None and viewer.dropped:
            parts.append(f"{viewer.dropped} not shown")
        if file is not None and file.lost:
            parts.append(f"{file.lost} NOT SAVED")
        if viewer is not None and viewer.window_closed:
            parts.append("viewer closed")
        if self._verbose:
            sensors = self._frames[-1].sensors
            parts.append(f"dropped {sensors.a.dropped}/{sensors.b.dropped}")
        return " · ".join(parts)

    def _advise(self, status: Status) -> None:
        calibrator = status.calibrator
        sensors = status.sensors
        situation = Situation(
            status.calibration,
            calibrator.final,
            calibrator.held,
            (sensors.a.dropped, sensors.b.dropped),
            (sensors.a.lost, sensors.b.lost),
            sensors.step,
        )
        findings = self._coach.watch(status.frame, situation)
        now_ns = status.frame.pair.time_ns
        shown = self._readiness.watch(now_ns * 1e-9, findings, situation.calibration)
        if self._sounds is not None:
            self._sounds.tell(shown)
        found, fused = self._readiness.findings, status.frame.fused
        notes = self._notes(now_ns, situation.calibration)
        drawn = replace(situation, calibration=self._coach.placed or situation.calibration)
        page = self._scene.page(found, drawn, fused, shown, notes, status.frame.floor)
        if page != self._page:
            self._page = page
            self._session.coach(page)
        self._say([each for each in findings if RULES[each.rule].is_event], now_ns)

    def _notes(self, now_ns: int, calibration: Calibration) -> list[str]:
        """What to know where nothing is wrong."""
        notes = [f"Calibration: {precision_in_words(calibration_figures(calibration))}."]
        minutes = (now_ns - self._began_ns) / 60e9
        if minutes < self._warm_up_min:
            notes.append(
                f"The sensors have run for {minutes:.0f} min; for the first {self._warm_up_min:.0f} their "
                "distances drift by millimetres. Calibrate again after that if you need them."
            )
        return notes

    def _say(self, findings: list[Finding], now_ns: int) -> None:
        """Logs a spell for each problem; the coach's page shows the rest.

        A figure about its threshold would begin and end many times a second: a problem has ended when it was
        not found for a while, and one that comes back soon is not printed again.
        """
        for each in findings:
            topic = f"{each.rule}_{each.side}".lower().strip("_")
            if topic not in self._said:
                text = f"{capital(each.reason)}. {capital(each.step)}."
                self._session.event(Event(text, "WARN", topic, "start"))
                printed_ns = self._printed.get(topic, -_SAID_AGAIN_NS)
                if not self._quiet and now_ns - printed_ns >= _SAID_AGAIN_NS:
                    self._printed[topic] = now_ns
                    self._console.print(in_flags(text), style="yellow", markup=False, soft_wrap=True)
            self._said[topic] = each.what, now_ns
        for topic, (what, last_ns) in list(self._said.items()):
            if now_ns - last_ns >= _OVER_AFTER_NS:
                del self._said[topic]
                self._session.event(Event(f"no longer: {what}", topic=topic, phase="end"))
