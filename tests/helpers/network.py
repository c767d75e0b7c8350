"""Addresses and messages for tests of network sessions."""

import numpy as np

from devices.network.messages import FrameMessage, encode_frame
from devices.sensor import SensorFrame
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.hub import free_port


def free_address():
    """A Zenoh address on this machine that nobody listens on now."""
    return f"tcp/{LOOPBACK}:{free_port()}"


def arrivals(seconds, *, lost, jitter_ns, seed, host_ahead_ns):
    """Frame messages of a sensor at 30 fps and when each arrives, in the order of their capture.

    Delays are 1 ms and up to twice the jitter. As over TCP, a late frame holds up those after it.
    """
    rng, sent, before_ns = np.random.default_rng(seed), list[tuple[int, bytes]](), 0
    for sequence in range(round(30 * seconds)):
        captured_ns = 1_000_000_000 + round(sequence * 1e9 / 30)
        frame = SensorFrame(captured_ns, host_ns=captured_ns + host_ahead_ns)
        data = encode_frame(FrameMessage(1, sequence, frame, captured_ns + host_ahead_ns))
        delay_ns = 1_000_000 + round(rng.uniform(0.0, 2.0 * jitter_ns))
        if rng.random() >= lost:
            before_ns = max(before_ns + 1, captured_ns + delay_ns)
            sent.append((before_ns, data))
    return sent
