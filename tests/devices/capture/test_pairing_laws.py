"""Laws of live pairing: whatever two sensors do, each frame comes out once, in time, at its true time."""

import heapq
from itertools import count

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from devices.capture.clock.host_clock import HostClock
from devices.capture.stream_pairing import LivePairing
from devices.sensor import SensorFrame
from tests.helpers.two_clocks import INTERVAL_NS, SECOND_NS

MS = 1_000_000
LATENCY_NS, JITTER_NS = 20 * MS, 5 * MS
POLL_NS = 10 * MS
MINUTE_NS = 60 * SECOND_NS
TIMES_NS = 60 * MS
"""How far a pair's time may be from the true one. The clocks differ by 50 ppm, 15 ms in five minutes. Each
of at most eight new clocks of A is found by one frame, to the jitter of 5 ms."""
SIDES = st.sampled_from("ab")


class Camera:
    """A sensor that captures at its moments, by a clock of its own."""

    def __init__(self, delay_ns, clock_ns, ppm):
        self.delay_ns, self.clock_ns, self.ppm = delay_ns, clock_ns, ppm
        self.lost = self.opening = self.newest_ns = 0
        self.heard_ns = -MINUTE_NS
        self.late_ns = self.held_until_ns = self.off_until_ns = 0
        self.twice = False

    def says(self, true_ns):
        return round(true_ns * (1 + self.ppm * 1e-6)) + self.clock_ns


class Pairing(RuleBasedStateMachine):
    """Two cameras, what happens to them, and what comes out."""

    @initialize(
        cable_ms=st.sampled_from([None, None, 0.16, -0.16, 12.0, -12.0]),
        phase_ms=st.floats(-16, 16),
        clocks=st.tuples(*[st.integers(-(10**12), 10**18)] * 2),
        ppm=st.tuples(*[st.floats(-25, 25)] * 2),
        every_frame=st.booleans(),
        seed=st.integers(0, 2**32),
    )
    def begin(self, cable_ms, phase_ms, clocks, ppm, every_frame, seed):
        self.cable = cable_ms is not None
        delay_ns = round((phase_ms if cable_ms is None else cable_ms) * MS)
        self.cameras = {"a": Camera(0, clocks[0], ppm[0]), "b": Camera(delay_ns, clocks[1], ppm[1])}
        self.set_by_master()
        self.pairing = LivePairing(INTERVAL_NS, sync_delay_ns=delay_ns if self.cable else None)
        self.pairing.every_frame = every_frame
        self.random, self.step, self.replugged = np.random.default_rng(seed), 1, 0
        self.now_ns = self.pulse_ns = 5 * SECOND_NS
        self.flying, self.order = [], count()
        self.truth, self.came, self.delivered = {}, {}, 0
        self.doubled = self.overtaken = 0
        self.out, self.last_ns, self.behind_ns, self.longest_ns = set(), None, None, 0

    def set_by_master(self):
        """On a cable the clocks are one, or far apart where the master did not set them."""
        a, b = self.cameras.values()
        if self.cable and abs(b.clock_ns - a.clock_ns) < SECOND_NS:
            b.clock_ns = a.clock_ns

    # --- What happens

    @rule(pulses=st.integers(1, 40))
    def run(self, pulses):
        for _ in range(pulses):
            self.pulse_ns += self.step * INTERVAL_NS
            for side, camera in self.cameras.items():
                self._capture(side, camera)
            self._pass(self.pulse_ns)

    @precondition(lambda self: self.delay_is_known())
    @rule(side=SIDES, late_ms=st.integers(0, 400))
    def late(self, side, late_ms):
        self.cameras[side].late_ns = late_ms * MS
        self.run(1)

    @rule(side=SIDES, frames=st.integers(1, 40))
    def lose(self, side, frames):
        self.cameras[side].lost = frames
        self.run(3)

    @rule(side=SIDES)
    def twice(self, side):
        self.cameras[side].twice = True
        self.run(1)

    @precondition(lambda self: self.delay_is_known())
    @rule(side=st.sampled_from(["a", "b", "ab"]), seconds=st.floats(0.1, 3.0))
    def hold_up(self, side, seconds):
        for each in side:
            self.cameras[each].held_until_ns = self.pulse_ns + round(seconds * SECOND_NS)
        self.run(int(seconds * SECOND_NS / (self.step * INTERVAL_NS)) + 2)

    @rule(side=SIDES, seconds=st.floats(0.05, 15.0), told=st.booleans())
    def stand_still(self, side, seconds, told):
        if told:
            self.pairing.set_gone(side, True)
        self._switch_off(side, seconds)

    @precondition(lambda self: self.replugged < 8)
    @rule(
        side=SIDES,
        seconds=st.floats(0.0, 5.0),
        moved_ns=st.one_of(st.integers(-40 * MS, 40 * MS), st.integers(-(10**17), 10**17)),
    )
    def replug(self, side, seconds, moved_ns):
        self.replugged += 1
        self.cameras[side].clock_ns += moved_ns
        self.set_by_master()
        self.cameras[side].opening += 1
        self._switch_off(side, seconds)

    @precondition(lambda self: self.replugged < 8)
    @rule(
        side=SIDES,
        ahead=st.booleans(),
        seconds=st.one_of(st.floats(0.6, 20.0), st.floats(0.6, 1e8)),
        silent_s=st.sampled_from([0.0, 1.0, 5.0, 12.0]),
    )
    def reset_clock(self, side, ahead, seconds, silent_s):
        """The firmware starts anew, at once or after a while, and nobody is told."""
        self.replugged += 1
        self.cameras[side].clock_ns += round((1 if ahead else -1) * seconds * SECOND_NS)
        self.set_by_master()
        self._switch_off(side, silent_s)

    @rule(step=st.integers(1, 6))
    def set_interval(self, step):
        self.pulse_ns += SECOND_NS  # the tolerance is that of frames which come from now on
        self._pass(self.pulse_ns)
        self.step = step
        self.pairing.set_interval(step * INTERVAL_NS)

    # --- What holds

    @invariant()
    def every_frame_is_out_once_or_counted(self):
        figures, waiting = self.pairing.figures, len(self.pairing._a.waiting + self.pairing._b.waiting)
        left_out = figures.late + figures.repeated + figures.unmatched_b
        assert len(self.out) + waiting + left_out == self.delivered
        assert waiting <= 9
        assert len(self.out) == 2 * figures.pairs + figures.alone_a + figures.alone_b
        assert figures.repeated <= self.doubled
        assert figures.reordered <= self.overtaken

    def teardown(self):
        if hasattr(self, "pairing"):
            self._pass(self.now_ns + 2 * SECOND_NS)
            assert not self.pairing._a.waiting + self.pairing._b.waiting

    # --- How it is done

    def delay_is_known(self):
        """The first frames after a minute, or of a new clock, tell the delay."""
        return all(
            self.now_ns - camera.heard_ns < MINUTE_NS - 5 * SECOND_NS for camera in self.cameras.values()
        )

    def _switch_off(self, side, seconds):
        camera = self.cameras[side]  # what is on its way does not arrive
        self.flying = [each for each in self.flying if each[2] != side]
        heapq.heapify(self.flying)
        camera.off_until_ns = self.pulse_ns + round(seconds * SECOND_NS)
        camera.heard_ns, camera.late_ns, camera.held_until_ns = -MINUTE_NS, 0, 0
        self.run(int(seconds * SECOND_NS / (self.step * INTERVAL_NS)) + 2)

    def _capture(self, side, camera):
        true_ns = self.pulse_ns + camera.delay_ns
        if camera.lost or self.pulse_ns < camera.off_until_ns:
            camera.lost = max(0, camera.lost - 1)
            return
        delay_ns = LATENCY_NS + min(round(self.random.exponential(MS)), JITTER_NS) + camera.late_ns
        arrives_ns = max(true_ns + delay_ns, camera.held_until_ns)
        host_ns = arrives_ns if self.random.integers(2) else None
        frame = SensorFrame(camera.says(true_ns), host_ns=host_ns)
        self.truth[id(frame)] = true_ns, frame  # kept, so that no other gets its id
        for _ in range(1 + camera.twice):
            heapq.heappush(self.flying, (arrives_ns, next(self.order), side, frame, camera.opening))
        camera.twice, camera.late_ns = False, 0

    def _pass(self, until_ns):
        """Delivers what arrives until a time, and polls every 10 ms."""
        opened = self.__dict__.setdefault("opened", {"a": 0, "b": 0})
        while self.now_ns < until_ns:
            next_ns = self.now_ns + POLL_NS
            while self.flying and self.flying[0][0] <= next_ns:
                at_ns, _, side, frame, opening = heapq.heappop(self.flying)
                if opening != opened[side]:
                    opened[side] = opening
                    self._check(self.pairing.restart(side), at_ns)
                self.delivered += 1
                self.cameras[side].heard_ns = at_ns
                self.doubled += id(frame) in self.came
                self.overtaken += self.truth[id(frame)][0] < self.cameras[side].newest_ns
                self.cameras[side].newest_ns = max(self.cameras[side].newest_ns, self.truth[id(frame)][0])
                self.came.setdefault(id(frame), at_ns)
                self._check(self.pairing.add(side, frame, at_ns), at_ns)
            self.now_ns = next_ns
            self._check(self.pairing.poll(next_ns), next_ns)

    def _check(self, pairs, now_ns):
        self.longest_ns = max(self.longest_ns, self.pairing.max_lag_ns + self.pairing.interval_ns)
        for pair in pairs:
            assert self.last_ns is None or pair.time_ns > self.last_ns
            self.last_ns = pair.time_ns
            for frame in filter(None, (pair.a, pair.b)):
                assert id(frame) not in self.out, "a frame came out twice"
                self.out.add(id(frame))
                assert now_ns - self.came[id(frame)] <= self.longest_ns + POLL_NS
            true_ns = self.truth[id(pair.a or pair.b)][0]
            said_ns = pair.time_ns + (pair.skew_ns if pair.a is None else 0)
            self.behind_ns = said_ns - true_ns if self.behind_ns is None else self.behind_ns
            assert abs(said_ns - true_ns - self.behind_ns) < TIMES_NS
            if pair.a is not None and pair.b is not None:
                skew_ns = self.truth[id(pair.b)][0] - true_ns
                apart_ns = abs(skew_ns - self.cameras["b"].delay_ns)
                assert apart_ns == 0 if self.cable else abs(skew_ns) <= self.step * INTERVAL_NS
                assert abs(pair.skew_ns - skew_ns) < 2 * JITTER_NS + MS


TestPairing = Pairing.TestCase
TestPairing = pytest.mark.filterwarnings("error")(TestPairing)


@given(
    silent_s=st.one_of(st.integers(0, 100), st.integers(0, 4000)),
    ppm=st.integers(-100, 100),
    late_ms=st.integers(0, 400),
)
def test_silence_costs_a_clock_no_more_than_its_drift_of_a_minute(silent_s, ppm, late_ms):
    """The first frame after it may be late; after more than a minute, it is all that is known.

    It is not believed alone where it is half a second off, as after a reset.
    """
    assume(abs(ppm) * 1e-3 * (silent_s + 20) + late_ms < 490)
    clock, at_ns = HostClock(), 0

    def off_ns(at_ns, late_ns=0):
        sensor_ns = round(at_ns * (1 + ppm * 1e-6))
        clock.observe(sensor_ns, at_ns + LATENCY_NS + late_ns)
        return clock.offset_ns - (at_ns + LATENCY_NS - sensor_ns)

    for at_ns in range(0, 20 * SECOND_NS, INTERVAL_NS):
        off_ns(at_ns)
    off = off_ns(at_ns + silent_s * SECOND_NS, late_ms * MS)
    drift_ns = abs(ppm) * 1e-6 * (min(silent_s, 60) + 12) * SECOND_NS
    assert abs(off) <= drift_ns + (late_ms * MS if silent_s > 45 else 0)
