"""Pairing of two recorded streams by capture time."""

import os
import sys
from dataclasses import replace

import numpy as np
import psutil
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from devices.capture.stream_pairing import LivePairing
from devices.pairing import _least_interval, _moments
from devices.recorded.apart import ApartError, items_of
from devices.sensor import DeviceError, SensorFrame
from devices.skeletons.times import capture_times
from fusion.body import KINECT_V1, KINECT_V2
from fusion.clocks import nearest_of
from fusion.clocks.parts import parts_joined
from fusion.skeleton import Skeleton
from tests.helpers import unreliable
from tests.helpers.continuous_motion import as_view, views_at
from tests.helpers.frame_pairs import paired
from tests.helpers.laws import COSTLY
from tests.helpers.programs import python
from tests.helpers.two_clocks import run, shots
from tests.helpers.two_views import FRAME_NS, standing
from tests.helpers.waiting import eventually


def frames_at(times_ns, person="0"):
    skeleton = Skeleton.of(KINECT_V1, standing(KINECT_V1))
    return [SensorFrame(t, {person: skeleton}) for t in times_ns]


TIMES = st.lists(st.integers(1, 60), min_size=1, max_size=60).map(lambda steps: np.cumsum(steps).tolist())


@given(TIMES, TIMES, st.booleans())
def test_no_frame_pairs_twice_or_with_one_of_another_moment(times_a, times_b, every_frame):
    interval = min(_least_interval(np.array(times)) for times in (times_a, times_b))
    try:
        pairing = paired(frames_at(times_a), frames_at(times_b), every_frame=every_frame)
    except DeviceError:
        assert min(abs(x - y) for x in times_a for y in times_b) > interval / 2
        return
    both = [pair for pair in pairing.pairs if pair.a is not None and pair.b is not None]
    for side, times in (("a", times_a), ("b", times_b)):
        used = [getattr(pair, side).time_ns for pair in pairing.pairs if getattr(pair, side) is not None]
        assert used == sorted(set(used))
        assert len(used) + getattr(pairing, f"dropped_{side}") == len(times)
        assert len(used) - len(both) == getattr(pairing, f"alone_{side}")
    assert all(2 * abs(pair.skew_ns) <= interval for pair in both)
    times = [pair.time_ns for pair in pairing.pairs]
    lone = [pair.a is None or pair.b is None for pair in pairing.pairs]
    assert times == sorted(times)
    assert not any(
        last and later - before < interval // 2
        for before, later, last in zip(times[:-1], times[1:], lone[1:], strict=True)
    )


@given(
    rate=st.sampled_from((30, 60, 90, 120)),
    lost=st.floats(0.0, 0.5),
    late_ms=st.tuples(st.integers(0, 200), st.integers(0, 200)),
    phase=st.floats(-0.45, 0.45),
    seed=st.integers(0, 99),
)
def test_pairs_follow_from_the_moments_however_the_frames_come(rate, lost, late_ms, phase, seed):
    """Those of a live run, whose clocks a cable has made one, are those of its recording."""
    random, begun_ns = np.random.default_rng(seed), 6_000_000_000
    a, b = (
        [
            replace(shot, arrives_ns=shot.arrives_ns + 1_000_000 * ms)
            for shot in shots(side, 4, fps=rate, phase_ns=round(phase_ns))
            if random.random() >= lost
        ]
        for side, ms, phase_ns in zip("ab", late_ms, (0, 1e9 * phase / rate), strict=True)
    )
    times = [np.array([shot.true_ns for shot in shots]) for shots in (a, b)]
    assume(abs(min(map(_least_interval, times)) - 1e9 / rate) < 1e3)
    live = run(LivePairing(round(1e9 / rate), sync_delay_ns=0), a, b)
    frames, _, _ = _moments((times[0], times[1]), every_frame=True)
    wanted = {(int(times[0][i]), int(times[1][j])) for i, j in frames.tolist() if i >= 0 and j >= 0}
    found = {(pair.a.time_ns, pair.b.time_ns) for pair in live if pair.a and pair.b}
    differ = [times for times in wanted ^ found if times[0] > begun_ns]  # its delays are known by then
    assert len(differ) <= 0.01 * len(wanted) + 1  # a frame may be later than all before


def test_recordings_that_never_overlap_are_refused_with_their_times():
    with pytest.raises(DeviceError, match=r"overlap.*A runs from 0\.000 s to 0\.033 s, B from 10\.000 s"):
        paired(frames_at([0, FRAME_NS]), frames_at([10_000_000_000]))


# --- Generators in a process of their own.


def items(function, *arguments, seconds=60.0):
    return items_of(function, *arguments, seconds=seconds, memory=4 << 30)


@pytest.mark.parametrize("function", [unreliable.crashes, unreliable.fails])
def test_a_crash_is_an_error_after_what_came_before(function):
    came = items(function)
    assert next(came) == "first"
    with pytest.raises(ApartError, match="it crashed"):
        next(came)


def test_an_error_of_the_program_passes_on():
    came = items(unreliable.refuses)
    assert next(came) == "first"
    with pytest.raises(DeviceError, match=r"^it is no recording$"):
        next(came)


def test_what_never_ends_is_ended():
    with pytest.raises(ApartError, match="it does not end"):
        list(items(unreliable.never_ends, seconds=0.5))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory")
def test_what_needs_too_much_memory_is_refused():
    with pytest.raises(ApartError, match="it does not fit into memory"):
        list(items(unreliable.hoards))


LIMITED = """
import resource
from devices.recorded.apart import items_of
from tests.helpers.unreliable import counts
resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))
print(*items_of(counts, 3, seconds=60.0, memory=8 << 30))
"""


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux limits the memory")
def test_a_lower_limit_of_the_memory_stays():
    """As of ``ulimit -v``; a process may not raise it."""
    assert python("-c", LIMITED).stdout == "0 1 2\n"


def test_the_standard_input_is_empty():
    """On Windows a library that looks at it waits until no other thread reads from it."""
    assert list(items(unreliable.reads_its_input, seconds=20.0)) == [b""]


PRESSED = """
import os, signal, threading
from devices.recorded.apart import items_of
from tests.helpers.unreliable import counts

os.setpgrp()
signal.signal(signal.SIGINT, lambda *_: None)  # as while a session is opened
ended = threading.Event()

def press():
    while not ended.wait(0.02):
        os.killpg(0, signal.SIGINT)

threading.Thread(target=press).start()
try:
    print(*items_of(counts, 3, seconds=60.0, memory=4 << 30))
finally:
    ended.set()
"""


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs groups of processes")
def test_ctrl_c_is_the_program_s_alone():
    """A terminal sends it to the whole group; the process would die while it starts."""
    assert python("-c", PRESSED).stdout == "0 1 2\n"


def test_who_stops_reading_ends_the_process():
    came = items(unreliable.tells_its_process)
    process = psutil.Process(next(came))
    came.close()
    assert eventually(lambda: not process.is_running())


ENDS_AT_ONCE = """
import os
from devices.recorded.apart import items_of
from tests.helpers.unreliable import tells_its_process
print(next(items_of(tells_its_process, seconds=60.0, memory=4 << 30)), flush=True)
os._exit(0)
"""


def test_the_process_ends_with_its_parent():
    number = int(python("-c", ENDS_AT_ONCE).stdout)
    assert eventually(lambda: not psutil.pid_exists(number))


@COSTLY
@given(
    sets=st.tuples(*[st.sampled_from((0, -60, -8, -1, -0.2, 0.2, 1, 8, 60, 86_400))] * 2),
    at=st.floats(6.0, 12.0),
    apart=st.floats(0.0, 4.0),
    lost=st.sampled_from([(0, 0), (0, 0), (3, 0), (0, 2), (3, 3)]),
    fps=st.sampled_from((15, 30)),
    seed=st.integers(0, 99),
)
@example(sets=(0.2, 86_400), at=7.3, apart=3.9, lost=(3, 0), fps=30, seed=16)
@example(sets=(-1, 60), at=11.6, apart=1.6, lost=(3, 0), fps=30, seed=49)
@example(sets=(8, 8), at=9.0, apart=1.9, lost=(0, 0), fps=30, seed=1)
def test_clocks_that_are_set_in_both_files_pair_no_frames_of_other_moments(sets, at, apart, lost, fps, seed):
    """Each at its own moment, where frames may be lost, too; few frames lose their partner."""
    true, views, told = [], [], []
    for side in (0, 1):
        seconds = np.arange(20 * fps) / fps + 0.4 / fps * side
        since = seconds - at - apart * side
        true.append(seconds[(since < 0) | (since >= lost[side] * (sets[side] != 0))])
    for side, positions in enumerate(views_at(*true, seed)):
        later = sets[side] * (true[side] >= at + apart * side)
        read = capture_times("ab"[side], "time_ns", np.rint(1e9 * (true[side] + later)).astype(np.int64))
        views.append(as_view(positions, true[side])._replace(time_ns=read.time_ns))
        told.append(read.sets)
    joined = parts_joined(KINECT_V2, *views, told)
    assert joined.unsure is None
    first_ns = [times[0] for times in joined.times]
    a, b = (1e-9 * (times - ns) + own[0] for times, ns, own in zip(joined.times, first_ns, true, strict=True))
    partner = nearest_of(a, b)
    paired = np.abs(b[partner] - a) <= 0.5 / fps
    off = np.abs(true[1][partner] - true[0])
    possible = np.abs(np.subtract.outer(true[0], true[1])).min(axis=1) < 0.5 / fps
    assert np.count_nonzero(paired & (off > 1.45 / fps)) <= 0.01 * len(a)
    assert np.count_nonzero(possible & ~paired) <= fps * (apart + 1)
