"""Lab Streaming Layer: S* and its angles as streams of type MoCap, events as a stream of type Markers.

Per joint four channels: x, y, z in metres in K_A's frame, and a confidence from 0 to 1. Without a person
positions are NaN and confidences 0. Per angle two channels: degrees, and their standard deviation.
"""

import time
from typing import Any
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from devices.capture.clock.capture_time import UNIX_NS
from devices.check import extra_command
from devices.events import Event
from fusion.body import Body
from fusion.fused_frame import FusedFrame
from fusion.movement.angles import ANGLES
from viewer_app.errors import UsageError
from viewer_app.outputs.live_movement import LiveMovement
from viewer_app.outputs.output import LiveOutput, confidence
from viewer_app.sinks.item_queue import QueuedFrame

_KEEP = 64  # frames; a recorder wants all of them
_LIVE_NS = 10_000_000_000  # from capture to sending, if it is no replay
_THIS_MACHINE = """
[multicast]
ResolveScope = machine
ListenAddress = 127.0.0.1
[ports]
IPv6 = disable
[log]
level = -2
"""
_CHANNELS = ("PositionX", "PositionY", "PositionZ", "Confidence")


def sample(fused: FusedFrame) -> NDArray[np.float32]:
    """(4 J,) the channels of one frame."""
    channels = np.empty((len(fused.positions), 4), dtype=np.float32)
    channels[:, :3] = fused.positions
    channels[:, 3] = confidence(fused)
    return channels.ravel()


class LabStreamingOutput(LiveOutput):
    """Three outlets: ``NAME``, ``NAME-angles`` and ``NAME-events``.

    A sample has the time of its capture on liblsl's clock, as other outputs have it. In a replay the first
    sample has the time at which it is sent.

    Args:
        others: Whether other machines may find the stream. If not, discovery is limited to this machine.
    """

    def __init__(self, name: str, body: Body, rate: float, others: bool = False) -> None:
        super().__init__(f"LSL stream {name}", keep=_KEEP)
        pylsl = load_pylsl(others)
        self.note = (
            "liblsl accepts connections on all network interfaces, port 16572 and the following; only a "
            "firewall can limit this."
        )
        source = f"duplex-kinects-{name}-{uuid4().hex[:8]}"
        info = pylsl.StreamInfo(name, "MoCap", 4 * len(body), rate, pylsl.cf_float32, source)
        _describe(info.desc(), body)
        events = pylsl.StreamInfo(f"{name}-events", "Markers", 1, 0.0, pylsl.cf_string, f"{source}-events")
        angles = f"{name}-angles", "MoCap", 2 * len(ANGLES), rate, pylsl.cf_float32, f"{source}-angles"
        of_angles = pylsl.StreamInfo(*angles)
        channels = of_angles.desc().append_child("channels")
        for label in (f"{angle}{of}" for angle in ANGLES for of in ("", "_sigma")):
            channel = channels.append_child("channel")
            channel.append_child_value("label", label)
            channel.append_child_value("unit", "degrees")
        self._samples, self._events, self._angles = map(pylsl.StreamOutlet, (info, events, of_angles))
        self._movement = LiveMovement(body)
        self._clock_offset = pylsl.local_clock() - time.perf_counter()
        self._later_ns: int | None = None  # by which a replay sends its frames after their capture
        self._stamp = -np.inf
        self.start()

    def send_frame(self, frame: QueuedFrame) -> int:
        """Pushes a sample of each stream; liblsl buffers them for each receiver."""
        unix_ns = frame.frame.unix_ns
        captured_ns = (frame.time_ns if unix_ns is None else unix_ns) - UNIX_NS
        if self._later_ns is None:
            ago_ns = frame.written_ns - captured_ns
            self._later_ns = 0 if ago_ns < _LIVE_NS else ago_ns
        self._stamp = max(1e-9 * (captured_ns + self._later_ns) + self._clock_offset, self._stamp + 1e-6)
        self._samples.push_sample(sample(frame.fused), self._stamp)
        degrees_and_sigma = np.stack(self._movement.angles(frame), axis=1).astype(np.float32)
        self._angles.push_sample(degrees_and_sigma.ravel(), self._stamp)
        for event in self._movement.new_events():
            happened = self._stamp + 1e-9 * (event.time_ns - frame.time_ns)
            self._events.push_sample([f"{event.level}: {event.text}"], happened)
        return 1

    def send_event(self, event: Event) -> None:
        """Pushes an event at the time of the last sample; before the first, of now."""
        stamp = self._stamp if np.isfinite(self._stamp) else 0.0
        self._events.push_sample([f"{event.level}: {event.text}"], stamp)

    def shut(self) -> None:
        del self._samples, self._events, self._angles


def load_pylsl(others: bool) -> Any:
    """The module ``pylsl``, with discovery limited to this machine unless `others`."""
    try:
        import pylsl
    except Exception as fault:
        raise UsageError(f"--lsl needs pylsl: {extra_command('lsl')}.") from fault
    if not others:
        pylsl.set_config_content(_THIS_MACHINE)
    return pylsl


def _describe(description: Any, body: Body) -> None:
    """The meta-data that the XDF specification lists for motion capture."""
    channels = description.append_child("channels")
    for joint in body.joints:
        for kind in _CHANNELS:
            channel = channels.append_child("channel")
            channel.append_child_value("label", f"{joint}_{kind}")
            channel.append_child_value("marker", joint)
            channel.append_child_value("object", body.name)
            channel.append_child_value("type", kind)
            channel.append_child_value("unit", "normalized" if kind == "Confidence" else "meters")
    acquisition = description.append_child("acquisition")
    acquisition.append_child_value("manufacturer", "duplex-kinects")
    acquisition.append_child_value("model", body.name)
    acquisition.append_child_value("compensated_lag", "0")
    setup = description.append_child("setup")
    setup.append_child_value("axes", "x right, y down, z forward, of the first sensor; right-handed")
