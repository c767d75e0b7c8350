"""The status line's fields, and a warning as one event and one when it is over."""

import io
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest
from rich.console import Console

from devices.events import Event
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from tests.helpers.live_frames import BODY, frames
from tests.helpers.two_views import A_FROM_B
from viewer_app.coach.advice import Advice
from viewer_app.running.status import LiveDisplay

WARNING = Advice("A's view", "Sensor A sees no one: 0 of 25 joints", "WARN", sensors="A", label="no one")


@pytest.fixture
def statuses():
    """Two seconds at 30 fps; A has dropped 3 frames, B 4."""
    fuser = Fuser(FusionSetup(Calibration(BODY, A_FROM_B, BODY.nominal_lengths, "known")))
    sensors = SimpleNamespace(
        a=SimpleNamespace(dropped=3, lost=5), b=SimpleNamespace(dropped=4, lost=6), step=2
    )
    calibrator = SimpleNamespace(final=True, held=0.0)
    known = fuser.setup.calibration
    return [
        SimpleNamespace(frame=frame, calibration=known, sensors=sensors, calibrator=calibrator, events=())
        for frame in frames(fuser, 60)
    ]


def later(status, frames):
    """The same status so many frames later."""
    pair = status.frame.pair
    skeletons = replace(pair.skeletons, time_ns=pair.time_ns + frames * 10**9 // 30)
    frame = replace(status.frame, pair=replace(pair, skeletons=skeletons))
    return SimpleNamespace(**{**vars(status), "frame": frame})


class Shown:
    """A display, a session that only listens, a coach whose advice the test gives, and what is printed."""

    def __init__(self, width=80, **options):
        self.printed = io.StringIO()
        self.session = MagicMock(
            file=MagicMock(failure=None, saves=True, written_bytes=12_340_000, lost=0),
            viewer=MagicMock(dropped=0, window_closed=False, window_failure=""),
        )
        self.coach = MagicMock(body=BODY, intrinsics=(MagicMock(), MagicMock()))
        self.coach.watch.return_value = []
        self.now = 0.0
        console = Console(file=self.printed, width=width, color_system=None)
        self.display = LiveDisplay(console, self.session, self.coach, clock=lambda: self.now, **options)
        self.display._scene = MagicMock()

    def events(self):
        return [call.args[0] for call in self.session.event.call_args_list]


def test_the_status_line_has_every_figure(statuses):
    shown = Shown()
    for status in statuses:
        assert shown.display(status)
    rates, skew, trust, fuse, saving = shown.display.line().split(" · ")
    assert rates == "fps 30/30"
    assert skew == "skew 0.0 ms"
    in_a, in_b = (float(of) for of in trust.removeprefix("trust ").split("/"))
    mean = [status.frame.fused.weights_a.mean() for status in statuses]
    assert in_a == pytest.approx(sum(mean) / len(mean), abs=0.006)
    assert 0.0 < in_b <= 1.0
    assert fuse.startswith("fuse ")
    assert fuse.endswith(" µs")
    assert saving == "saving 12.3 MB"


def test_the_status_line_says_what_goes_wrong(statuses):
    shown = Shown()
    shown.display(statuses[0])
    shown.session.file.configure_mock(failure="The disk is full.", lost=2)
    shown.session.viewer.configure_mock(dropped=5, window_closed=True)
    assert shown.display.line().split(" · ")[-4:] == [
        "SAVING STOPPED", "5 not shown", "2 NOT SAVED", "viewer closed",
    ]  # fmt: skip


def test_a_window_that_is_given_up_is_said_once(statuses):
    shown = Shown()
    shown.session.viewer.configure_mock(window_failure="No window.")
    for status in statuses:
        shown.display(status)
    assert shown.printed.getvalue().count("No window. The fusion continues.") == 1


@pytest.mark.parametrize("quiet", [False, True])
def test_a_warning_is_one_event_and_one_when_it_is_over(statuses, quiet):
    shown = Shown(quiet=quiet)
    advised = [[], *[[WARNING]] * 5, *[[]] * 54]
    for status, advice in zip(statuses, advised, strict=True):
        shown.coach.watch.return_value = advice
        shown.display(status)
    begins = Event(WARNING.text, "WARN")
    assert shown.events() == [begins]  # 1.8 s without it
    for k in (6, 7):
        shown.display(later(statuses[-1], k))
    assert shown.events() == [begins, Event("no longer: sensor A sees no one")]
    assert shown.printed.getvalue() == ("" if quiet else f"{WARNING.text}\n")


def test_a_warning_about_its_threshold_is_not_repeated(statuses):
    shown = Shown()
    for k, status in enumerate(statuses):
        text = f"Sensor A sees {k} of 25 joints"  # its figure changes, too
        shown.coach.watch.return_value = [replace(WARNING, text=text)] if k % 3 else []
        shown.display(status)
    assert len(shown.events()) == 1
    shown.coach.watch.return_value = []
    shown.display(later(statuses[-1], 90))
    shown.coach.watch.return_value = [WARNING]
    shown.display(later(statuses[-1], 91))
    assert shown.events()[-1] == Event(WARNING.text, "WARN")  # it came back, which the session tells
    assert shown.printed.getvalue() == "Sensor A sees 1 of 25 joints\n"
    shown.coach.watch.return_value = []
    shown.display(later(statuses[-1], 2000))
    shown.coach.watch.return_value = [WARNING]
    shown.display(later(statuses[-1], 2001))
    assert shown.printed.getvalue().endswith(f"\n{WARNING.text}\n")  # a minute later


def test_the_coach_knows_what_the_sensors_do(statuses):
    shown = Shown()
    shown.display(statuses[0])
    situation = shown.coach.watch.call_args.args[1]
    assert (situation.dropped, situation.lost, situation.step) == ((3, 4), (5, 6), 2)
