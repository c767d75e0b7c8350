"""Every sink gets the loop's frames. A sink that fails does not affect the others."""

import pytest

from devices.events import Event
from tests.helpers.live_frames import frames, known_fuser
from viewer_app.sinks.sink import FanOut, Sink

LOST = Event("A is lost", "WARN", "A", "start")


class Kept(Sink):
    """Records its calls; ``close`` raises if requested."""

    def __init__(self, fault=None):
        self.calls = []
        self._fault = fault

    def __getattribute__(self, name):
        if name.startswith("_") or name == "calls":
            return super().__getattribute__(name)

        def call(*arguments):
            self.calls.append((name, arguments))
            if name == "close" and self._fault is not None:
                raise self._fault

        return call


def use(sink):
    fuser = known_fuser()
    sink.write(frames(fuser, 1)[0])
    sink.event(LOST)
    sink.recalibrated(fuser.setup)
    sink.coach(None)
    sink.finish()
    sink.close()


def test_every_sink_gets_everything_in_order():
    one, two = Kept(), Kept()
    use(FanOut((one, two)))
    assert [name for name, _ in one.calls] == [
        "write", "event", "recalibrated", "coach", "finish", "close",
    ]  # fmt: skip
    assert [name for name, _ in two.calls] == [name for name, _ in one.calls]
    assert one.calls[1] == ("event", (LOST,))


def test_all_are_closed_although_one_fails():
    one, two, three = Kept(), Kept(OSError("the disk is full")), Kept()
    with pytest.raises(OSError, match="the disk is full"):
        FanOut((one, two, three)).close()
    assert one.calls == two.calls == three.calls == [("close", ())]


def test_a_sink_without_methods_takes_everything():
    use(Sink())
