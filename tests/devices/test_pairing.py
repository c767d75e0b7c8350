"""Pairing of two recorded streams by capture time."""

import os
import sys

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.recorded.apart import ApartError, items_of
from devices.sensor import DeviceError, SensorFrame
from fusion.body import KINECT_V1
from fusion.skeleton import Skeleton
from tests.helpers import unreliable
from tests.helpers.frame_pairs import paired
from tests.helpers.programs import python
from tests.helpers.two_views import FRAME_NS, standing
from tests.helpers.waiting import eventually


def frames_at(times_ns, person="0"):
    skeleton = Skeleton.of(KINECT_V1, standing(KINECT_V1))
    return [SensorFrame(t, {person: skeleton}) for t in times_ns]


def test_frames_pair_with_the_nearest_within_half_a_frame():
    a = frames_at([t * FRAME_NS for t in range(100)])
    b = frames_at([t * FRAME_NS + 5_000_000 for t in range(100) if t not in (10, 11, 50)])
    pairing = paired(a, b)
    assert len(pairing.pairs) == 97
    assert (pairing.dropped_a, pairing.dropped_b) == (3, 0)
    assert {pair.skew_ns for pair in pairing.pairs} == {5_000_000}


def test_frames_in_a_gap_of_the_other_recording_are_given_alone():
    a = frames_at([t * FRAME_NS for t in range(100)])
    b = frames_at([t * FRAME_NS for t in range(10, 90) if not 40 <= t < 60])
    pairing = paired(a, b)
    alone = [pair.time_ns // FRAME_NS for pair in pairing.pairs if pair.b is None]
    assert alone == list(range(41, 59))  # the gap's edges are within 1.5 frames of a frame of B
    assert (pairing.alone_a, pairing.dropped_a) == (18, 22)
    assert [pair.skeletons.b for pair in pairing.pairs if pair.b is None] == [None] * 18


def test_a_slower_sensor_has_no_gaps():
    a = frames_at([t * FRAME_NS for t in range(300)])
    b = frames_at([t * FRAME_NS * 6 // 5 for t in range(250)])  # 25 fps
    pairing = paired(a, b)
    assert (pairing.alone_a, pairing.alone_b) == (0, 0)
    assert pairing.dropped_a >= 49


def test_every_frame_is_kept_for_a_method_that_takes_single_views():
    a = frames_at([t * FRAME_NS for t in range(300)])
    b = frames_at([t * FRAME_NS * 2 for t in range(150)])  # half the rate
    pairing = paired(a, b, every_frame=True)
    assert (pairing.alone_a, pairing.alone_b) == (150, 0)
    assert (pairing.dropped_a, pairing.dropped_b) == (0, 0)  # the last of A is after all of B
    assert len(pairing.pairs) == 300


def test_an_offset_puts_the_frames_of_b_on_the_clock_of_a():
    a = frames_at([t * FRAME_NS for t in range(100)])
    b = frames_at([t * FRAME_NS + 7_000_000_000 for t in range(100)])
    pairing = paired(a, b, offset_ns=-6_990_000_000)
    assert len(pairing.pairs) == 100
    assert {pair.skew_ns for pair in pairing.pairs} == {10_000_000}
    assert pairing.pairs[5].b.time_ns == 5 * FRAME_NS + 7_000_000_000  # on its own clock


@given(
    st.lists(st.integers(0, 2000), min_size=1, max_size=60, unique=True),
    st.lists(st.integers(0, 2000), min_size=1, max_size=60, unique=True),
    st.integers(1, 300),
    st.booleans(),
)
def test_no_frame_pairs_twice_or_beyond_the_tolerance(times_a, times_b, tolerance, every_frame):
    a, b = frames_at(sorted(times_a)), frames_at(sorted(times_b))
    try:
        pairing = paired(a, b, tolerance_ns=tolerance, every_frame=every_frame)
    except DeviceError:
        assert min(abs(x - y) for x in times_a for y in times_b) > tolerance
        return
    used_b = [pair.b.time_ns for pair in pairing.pairs if pair.b is not None]
    assert len(set(used_b)) == len(used_b)
    assert [pair.time_ns for pair in pairing.pairs] == sorted(pair.time_ns for pair in pairing.pairs)
    assert all(abs(pair.skew_ns) <= tolerance for pair in pairing.pairs)
    both = [pair for pair in pairing.pairs if pair.a is not None and pair.b is not None]
    assert len(both) + pairing.alone_a + pairing.dropped_a == len(times_a)
    assert len(both) + pairing.alone_b + pairing.dropped_b == len(times_b)
    if every_frame:
        assert pairing.dropped_a == pairing.dropped_b == 0
    assert len(pairing.pairs) == len(both) + pairing.alone_a + pairing.alone_b
    # the closest two frames of all always find each other
    closest = min(abs(x - y) for x in times_a for y in times_b)
    assert min(abs(pair.skew_ns) for pair in both) == closest


def test_recordings_that_never_overlap_are_refused_with_their_times():
    with pytest.raises(DeviceError, match=r"overlap.*A runs from 0\.000 s to 0\.033 s, B from 10\.000 s"):
        paired(frames_at([0, FRAME_NS]), frames_at([10_000_000_000]))


def test_a_person_absent_from_a_frame_is_none_there():
    a = [*frames_at([0]), SensorFrame(FRAME_NS)]
    pairing = paired(a, frames_at([0, FRAME_NS], "5"))
    assert pairing.pairs[0].skeletons.a is not None
    assert pairing.pairs[1].skeletons.a is None
    assert pairing.pairs[1].skeletons.b is not None


def test_times_far_from_zero_pair_exactly():
    start = 1_700_000_000_000_000_000  # a wall clock in ns is beyond a float's whole numbers
    times = [start + t * FRAME_NS for t in range(10)]
    pairing = paired(frames_at(times), frames_at([t + 1 for t in times]))
    assert np.all([pair.skew_ns == 1 for pair in pairing.pairs])


# --- Generators in a process of their own.


def items(function, *arguments, seconds=60.0):
    return items_of(function, *arguments, seconds=seconds, memory=4 << 30)


def test_all_items_come_and_what_is_printed_is_none_of_them():
    assert list(items(unreliable.counts, 1000)) == list(range(1000))


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
