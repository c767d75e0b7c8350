"""The live loop on known pairs: person, truth, latency, settings, and what comes first."""

import gc
import os
import sys
from dataclasses import replace
from itertools import islice

import numpy as np
import psutil
import pytest

from devices.depth import witness as depth_witness
from devices.events import Event
from devices.frame_pairs import FramePair
from devices.sensor import SensorFrame
from devices.simulated.kinect import simulated_pair
from fusion.body import KINECT_V1
from fusion.calibration.calibration import calibrate, nominal_calibration
from fusion.fuser import Fuser
from fusion.registration import refinement
from fusion.setup import FusionSetup
from fusion.skeleton import SkeletonPair
from recordings.live_fusion import LiveFusion
from tests.experiments.soak import Soak, at_pace, soak
from tests.helpers.frame_pairs import KnownSensors, frame_pairs
from tests.helpers.two_views import A_FROM_B, FRAME_NS, pair_of, standing
from viewer_app.running.loop import low_latency, run_live
from viewer_app.running.runner import latency_figures
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
    """Pairs of a simulated walk, with images, and the setup at the start."""
    a, b, _ = simulated_pair(motion="walk", body=KINECT_V1, depth="half")
    setup = FusionSetup(nominal_calibration(a.body), None, a.intrinsics, b.intrinsics)
    both = islice(zip(a.frames(), b.frames(), strict=False), count)
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
