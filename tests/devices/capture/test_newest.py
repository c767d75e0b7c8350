"""Frames on a thread of their own: the newest for a slow reader, none unseen without a count."""

import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.capture.frame_decimation import Newest


class Source:
    """Numbers that come when they are let go, and what became of them."""

    def __init__(self, fault=None):
        self.dropped, self.interrupted, self._fault = 0, threading.Event(), fault
        self._let, self._came, self._at = threading.Condition(), 0, 0

    def items(self):
        while True:
            with self._let:
                assert self._let.wait_for(lambda: self._came > self._at or self.interrupted.is_set(), 60.0)
                if self.interrupted.is_set():
                    if self._fault is not None:
                        raise self._fault
                    return
                self._at += 1
            yield self._at

    def let(self, count):
        """Lets so many more come."""
        with self._let:
            self._came += count
            self._let.notify_all()

    def interrupt(self):
        with self._let:
            self.interrupted.set()
            self._let.notify_all()

    def drop(self):
        self.dropped += 1

    def newest(self):
        return Newest(self.items(), "numbers", drop=self.drop, interrupt=self.interrupt)


@given(st.lists(st.integers(1, 5), min_size=1, max_size=8))
def test_a_reader_of_any_speed_gets_the_newest_and_the_rest_are_counted(bursts):
    source = Source()
    reader, seen = source.newest(), []
    for count in bursts:
        source.let(count)
        seen.append(next(reader))
    source.interrupt()
    seen += reader
    assert seen == sorted(set(seen))
    assert seen[-1] == sum(bursts), "the last one is never lost"
    assert len(seen) + source.dropped == sum(bursts)


def test_a_fault_is_raised_after_the_item_before_it():
    source = Source(fault=ValueError("unplugged"))
    reader = source.newest()
    source.let(1)
    assert next(reader) == 1
    source.interrupt()
    with pytest.raises(ValueError, match="unplugged"):
        next(reader)


def test_a_reader_that_ends_first_ends_the_thread():
    source = Source()
    reader = source.newest()
    source.let(1)
    assert next(reader) == 1
    reader.close()
    assert source.interrupted.is_set()
    assert "numbers" not in {thread.name for thread in threading.enumerate()}
    reader.close()
