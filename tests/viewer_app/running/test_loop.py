"""The live loop on known pairs: person, truth, latency, settings, and what comes first."""

import gc
import io
import os
import sys
import wave
from dataclasses import replace
from itertools import chain, islice
from types import SimpleNamespace
from unittest import mock
from unittest.mock import MagicMock

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from devices.depth import witness as depth_witness
from devices.events import Event
from devices.findings.finding import Finding
from devices.frame_pairs import FramePair
from devices.sensor import SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.body import KINECT_V1
from fusion.calibration.calibration import Calibration, calibrate, nominal_calibration
from fusion.fuser import Fuser
from fusion.registration import refinement
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.appearance.state_card import TONES, State
from recordings.live_fusion import LiveFusion
from tests.helpers.frame_pairs import KnownSensors, frame_pairs
from tests.helpers.live_frames import BODY, frames
from tests.helpers.soak import Soak, at_pace, soak
from tests.helpers.two_views import A_FROM_B, FRAME_NS, pair_of, standing
from viewer_app.coach.readiness import Headline
from viewer_app.running.loop import low_latency, run_live
from viewer_app.running.runner import latency_figures
from viewer_app.running.sounds import RATE, Sounds, player, sound_of
from viewer_app.running.status import LiveDisplay
from viewer_app.sinks.sink import FanOut, Sink

NOMINAL = FusionSetup(nominal_calibration(KINECT_V1))


def test_the_truth_is_that_of_a_sensors_own_time():
    """The clock of A is set back by a second, then A misses a frame."""
    asked = []
    start = 10**10
    truth = standing(KINECT_V1)
    pairs = []
    for t in range(4):
        time_ns = start + t * FRAME_NS
        clock_ns = time_ns - (10**9 if t > 1 else 0)
        seen = pair_of(KINECT_V1, truth, clock_ns)
        a = SensorFrame(clock_ns, {"1": seen.a}) if t < 3 else None
        b = SensorFrame(clock_ns, {"1": seen.b})
        pairs.append(FramePair(a, b, SkeletonPair(None, None, time_ns)))

    def truth_at(time_ns):
        asked.append(time_ns)
        return truth

    run_live(KnownSensors(pairs), NOMINAL, Sink(), truth_at=truth_at)
    assert asked == [start, start + FRAME_NS, *(start + t * FRAME_NS - 10**9 for t in (2, 3))]


@pytest.mark.parametrize(("known", "b_follows"), [(False, None), (True, "9")])
def test_both_sensors_follow_one_person_once_they_know_each_others_place(known, b_follows):
    """Of two people, one is in the middle of A's view, the other in the middle of B's.

    Until somebody's place is known in both, S* is of A alone.
    """
    person = standing(KINECT_V1)
    middle = person[list(KINECT_V1.torso)].mean(axis=0)
    # the first 1.9 m before A, the second 2.6 m before B, each on that sensor's axis; about a metre apart
    places = np.array([0.0, 0.0, 1.9]), A_FROM_B.apply([0.0, 0.0, 2.6])
    pairs = []
    for time_ns in (0, FRAME_NS, 2 * FRAME_NS):
        one, two = (pair_of(KINECT_V1, person + place - middle, time_ns) for place in places)
        a = SensorFrame(time_ns, {"1": one.a, "2": two.a})
        b = SensorFrame(time_ns, {"8": two.b, "9": one.b})
        pairs.append(FramePair(a, b, SkeletonPair(None, None, time_ns)))
    before = FusionSetup(calibrate(KINECT_V1, [pair_of(KINECT_V1, person)], "before"))
    _, frames = run_live(KnownSensors(pairs), before if known else NOMINAL, Sink(), calibrated=known)
    assert len(frames) == len(pairs)
    for pair in (frame.pair for frame in frames):
        assert pair.skeletons.a is pair.a.people["1"]
        assert pair.skeletons.b is (None if b_follows is None else pair.b.people[b_follows])


def test_b_alone_has_no_s_star_before_its_place_is_known():
    pairs = frame_pairs(KINECT_V1, 20, no_a=range(10))
    _, frames = run_live(KnownSensors(pairs), NOMINAL, Sink())
    assert [frame.fused.has_person for frame in frames] == 10 * [False] + 10 * [True]
    assert all(frame.pair.skeletons.b is not None for frame in frames)


def test_latency_counts_from_the_images_that_arrived_first():
    """Its figures are milliseconds of the frames that have it."""
    arrived = ((100, 140), (300, 290), (None, 500), (None, None))
    done = iter((1_100, 1_300, 1_600, 1_900))
    pairs = []
    for t, times in enumerate(arrived):
        seen = pair_of(KINECT_V1, standing(KINECT_V1), t * FRAME_NS)
        a, b = (
            SensorFrame(t * FRAME_NS, {"1": skeleton}, host_ns=None if ms is None else ms * 1_000_000)
            for skeleton, ms in zip((seen.a, seen.b), times, strict=True)
        )
        pairs.append(FramePair(a, b, SkeletonPair(None, None, t * FRAME_NS)))
    _, frames = run_live(KnownSensors(pairs), NOMINAL, Sink(), clock=lambda: next(done) * 1_000_000)
    assert [frame.latency_ns for frame in frames] == [1_000_000_000, 1_010_000_000, 1_100_000_000, None]
    figures = latency_figures(frames)
    assert (figures["p50"], figures["max"]) == (1_010.0, 1_100.0)
    assert figures["p99"] == pytest.approx(1_100.0 - 0.02 * 90.0)  # linear between the last two
    silent = [replace(frame, latency_ns=None) for frame in frames]
    assert latency_figures(silent) == {"p50": None, "p99": None, "max": None}


def test_a_sink_is_told_each_setup_before_its_frames_and_every_event():
    class Telling(KnownSensors):
        told = 0

        def events(self):
            self.told += 1
            return [Event(f"number {self.told}")]

    class Told(Sink):
        setup, setups, said = NOMINAL, 0, ()

        def recalibrated(self, setup):
            assert setup is not self.setup
            self.setup, self.setups = setup, self.setups + 1

        def write(self, frame):
            assert frame.bone_lengths is self.setup.calibration.bone_lengths

        def event(self, event):
            self.said += (event.text,)

    sensors, told = Telling(frame_pairs(KINECT_V1, 75)), Told()
    run_live(sensors, NOMINAL, told)
    assert told.setups == sum(text.startswith("calibrated") for text in told.said) > 0
    numbers = [text for text in told.said if text.startswith("number")]
    assert numbers == [f"number {k + 1}" for k in range(sensors.told)]
    assert len(numbers) == 76, "after each pair, and after the last one"


def test_latency_settings_apply_only_while_the_loop_runs():
    interval = 0.0041  # not what another test may have left
    sys.setswitchinterval(interval)
    try:
        with low_latency():
            assert sys.getswitchinterval() < 0.001  # what logging may hold up the loop by
            assert len(gc.get_objects()) < 1000  # what a search for garbage goes through
        assert sys.getswitchinterval() == pytest.approx(interval, abs=2e-6)  # whole microseconds
        assert gc.get_freeze_count() == 0
    finally:
        sys.setswitchinterval(0.005)  # Python's own


def walking(count):
    """Pairs of a simulated walk, the first of them with images, and the setup at the start."""
    (a, b, _), (c, d, _) = (
        simulated_pair(motion="walk", body=KINECT_V1, depth=of) for of in ("half", "none")
    )
    setup = FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
    with_images, without = (
        zip(*each, strict=False) for each in ((a.frames(), b.frames()), (c.frames(), d.frames()))
    )
    both = chain(islice(with_images, min(count, 20)), islice(without, 20, count))
    return setup, [FramePair(of_a, of_b, SkeletonPair(None, None, of_a.time_ns)) for of_a, of_b in both]


@pytest.mark.parametrize("waiting", [False, True])
def test_a_frame_is_handed_over_before_the_program_learns_from_it(waiting, monkeypatch):
    """And learning leaves the viewer's thread alone, unless the next frame waits already."""
    done = []

    class Handed(Sink):
        def write(self, frame):
            assert frame.fused.has_person
            done.append("handed over")

        def rest(self, seconds):
            assert 0.0 < seconds < 0.5 / 30.0
            done.append("rested")

    learn = LiveFusion.learn
    monkeypatch.setattr(LiveFusion, "learn", lambda *of: (done.append("learned"), learn(*of))[1])
    setup, pairs = walking(2)
    run_live(KnownSensors(pairs, waiting), setup, FanOut([Handed()]))
    assert done == ["handed over", *([] if waiting else ["rested"]), "learned"] * 2


def test_nothing_is_compiled_after_the_first_frame(monkeypatch):
    """What a live session calls is compiled before its sensors open: a kernel takes seconds."""
    fits = []
    fit = refinement.fit_robust
    monkeypatch.setattr(refinement, "fit_robust", lambda *of, **more: (fits.append(1), fit(*of, **more))[1])
    setup, pairs = walking(240)
    Fuser(setup).warm_up()
    depth_witness.warm_up()
    fusion = LiveFusion(setup)
    before = compiled()
    for pair in pairs:
        fusion.learn(fusion.fuse(fusion.chosen(pair)))
    assert fusion.calibrator.final
    assert len(fits) >= 3, "a whole proposal"
    assert compiled() == before


def compiled():
    """How many versions each kernel of the method and of the devices has."""
    packages = "fusion", "devices.depth.witness", "devices.depth.rvl"
    return {
        f"{title}.{name}": len(kernel.overloads)
        for title, module in list(sys.modules.items())
        if title.startswith(packages)
        for name, kernel in vars(module).items()
        if hasattr(kernel, "overloads")
    }


def test_no_pair_is_lost_and_no_queue_grows(tmp_path):
    if psutil.getloadavg()[0] > 2.0 * (os.cpu_count() or 1):
        pytest.skip("this machine is too busy to tell frames that we lose from frames that it loses")
    seen = soak(3.0, "none", tmp_path / "soak.rrd")
    figures = seen.pairing
    assert seen.dropped == (0, 0)
    assert (figures.alone_a, figures.alone_b, figures.unmatched_b, figures.late) == (0, 0, 0, 0)
    assert at_pace(seen)
    assert seen.waiting <= 8
    assert seen.saved_mb > 0.1
    assert figures.pairs == seen.frames


def test_growth_is_measured_from_the_end_of_the_first_minute():
    flat = Soak(memory=[(float(s), 100.0 + min(s, 60)) for s in range(300)])
    assert flat.growth_mb == pytest.approx(0.0)
    leaking = Soak(memory=[(float(s), 100.0 + 0.1 * s) for s in range(300)])
    # from the middle of the 15 s that are the base to the end
    assert leaking.growth_mb == pytest.approx(0.1 * (299 - 67))


# --- The status line's fields, and a warning as one event and one when it is over.


WARNING = Finding("unseen", "poor", "A sees no one", "0 of 25 joints", "step into its view", "A")
TEXT = "A sees no one; 0 of 25 joints. Step into its view."


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
        file = MagicMock(failure=None, waited=None, saves=True, written_bytes=12_340_000, lost=0)
        self.session = MagicMock(
            open_file=file,
            files=[file],
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
    shown.session.open_file.configure_mock(failure="The disk is full.", lost=2)
    shown.session.viewer.configure_mock(dropped=5, window_closed=True)
    assert shown.display.line().split(" · ")[-4:] == [
        "SAVING STOPPED", "5 not shown", "2 NOT SAVED", "viewer closed",
    ]  # fmt: skip


def test_what_fails_is_said_once(statuses):
    shown = Shown()
    shown.session.viewer.configure_mock(window_failure="No window.")
    shown.session.files.append(MagicMock(failure=None, waited="No room."))  # a page asked for it
    for status in statuses:
        shown.display(status)
    for what in ("No window.", "No room."):
        assert shown.printed.getvalue().count(f"{what} The fusion continues.") == 1


@pytest.mark.parametrize("quiet", [False, True])
def test_a_warning_is_one_event_and_one_when_it_is_over(statuses, quiet):
    shown = Shown(quiet=quiet)
    advised = [[], *[[WARNING]] * 5, *[[]] * 54]
    for status, advice in zip(statuses, advised, strict=True):
        shown.coach.watch.return_value = advice
        shown.display(status)
    begins = Event(TEXT, "WARN", "unseen_a", "start")
    assert shown.events() == [begins]  # 1.8 s without it
    for k in (6, 7):
        shown.display(later(statuses[-1], k))
    assert shown.events() == [begins, Event("no longer: A sees no one", topic="unseen_a", phase="end")]
    assert shown.printed.getvalue() == ("" if quiet else f"{TEXT}\n")


def test_a_warning_about_its_threshold_is_not_repeated(statuses):
    shown = Shown()
    for k, status in enumerate(statuses):
        limit = f"{k} of 25 joints"  # its figure changes, too
        shown.coach.watch.return_value = [replace(WARNING, limit=limit)] if k % 3 else []
        shown.display(status)
    assert len(shown.events()) == 1
    shown.coach.watch.return_value = []
    shown.display(later(statuses[-1], 90))
    shown.coach.watch.return_value = [WARNING]
    shown.display(later(statuses[-1], 91))
    assert shown.events()[-1] == Event(TEXT, "WARN", "unseen_a", "start")
    assert shown.printed.getvalue() == "A sees no one; 1 of 25 joints. Step into its view.\n"
    shown.coach.watch.return_value = []
    shown.display(later(statuses[-1], 2000))
    shown.coach.watch.return_value = [WARNING]
    shown.display(later(statuses[-1], 2001))
    assert shown.printed.getvalue().endswith(f"\n{TEXT}\n")  # a minute later


def test_the_coach_knows_what_the_sensors_do(statuses):
    shown = Shown()
    shown.display(statuses[0])
    situation = shown.coach.watch.call_args.args[1]
    assert (situation.dropped, situation.lost, situation.step) == ((3, 4), (5, 6), 2)


# --- Tones of a set-up: one for each new state or thing to do.


HEADLINES = [
    Headline(State.NOT_YET, "step back 0.5 m", "distance"),
    Headline(State.NOT_YET, "step back 1.0 m", "distance"),
    Headline(State.NOT_YET, "move B", "angle"),
    Headline(State.NOT_YET, "step into view of A", "unseen"),
    Headline(State.ALMOST, "walk a few steps", "precision"),
    Headline(State.READY, "record now"),
]


@given(st.lists(st.sampled_from(HEADLINES)))
def test_a_sound_is_played_for_each_new_state_or_thing_to_do(shown):
    played = []
    with Sounds(lambda path: played.append(path.stem)) as sounds:
        for each in shown:
            sounds.tell(each)
    about = [(each.state, each.kind) for each in shown]
    new = [each for k, each in enumerate(shown) if k == 0 or about[k] != about[k - 1]]
    assert played == [sound_of(each).replace(" ", "_") for each in new if sound_of(each)]


def test_lost_ready_and_not_yet_sound_different():
    assert [sound_of(each) for each in HEADLINES] == ["not yet", "not yet", "not yet", "lost", "", "ready"]


@pytest.mark.parametrize("name", TONES)
def test_a_file_has_its_tones(name):
    with Sounds(mock.Mock()) as sounds, wave.open(str(sounds._path(name))) as file:
        samples = np.frombuffer(file.readframes(file.getnframes()), "<i2").astype(float)
    ends = np.cumsum([round(seconds * RATE) for _, seconds in TONES[name]])
    assert len(samples) == ends[-1]
    for (hertz, seconds), part in zip(TONES[name], np.split(samples / 32768.0, ends[:-1]), strict=True):
        loud = np.sqrt(np.mean(part**2))
        if hertz == 0.0:
            assert loud == 0.0
            continue
        assert 300.0 < hertz < 4000.0  # a laptop's loudspeaker plays it, and all people hear it
        power = np.abs(np.fft.rfft(part * np.hanning(len(part)))) ** 2
        near = slice(int((hertz - 30.0) * seconds), int((hertz + 30.0) * seconds) + 1)
        assert power[near].sum() > 0.99 * power.sum()
        assert 0.2 < loud < 0.5
        assert np.abs(part).max() < 1.0  # it is not cut off
        assert max(abs(part[0]), abs(part[-1])) < 0.003  # no click


def test_a_system_without_a_program_that_plays_has_no_player(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr("shutil.which", lambda name: None)
    assert player() is None
    monkeypatch.setattr("shutil.which", lambda name: name == "aplay" or None)
    started = mock.Mock()
    monkeypatch.setattr("subprocess.Popen", started)
    player()("s.wav")
    assert started.call_args.args[0] == ["aplay", "-q", "s.wav"]
