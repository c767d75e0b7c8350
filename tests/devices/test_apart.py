"""Generators in a process of their own."""

import os
import sys

import psutil
import pytest

from devices.recorded.apart import ApartError, items_of
from devices.sensor import DeviceError
from tests.helpers import unreliable
from tests.helpers.programs import python
from tests.helpers.waiting import eventually


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
