"""Addresses for tests of network sessions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from devices.network.messages import FrameMessage, encode_frame
from devices.sensor import SensorFrame
from viewer_app.addresses import LOOPBACK
from viewer_app.viewer.rerun_process import free_port


def free_address() -> str:
    """A Zenoh address on this machine that nobody listens on now."""
    return f"tcp/{LOOPBACK}:{free_port()}"


@dataclass(frozen=True)
class Journey:
    """Losses, delays and duplicates of messages on their way.

    Attributes:
        lost: Share that never arrives.
        jitter_ns: Delays are spread evenly over twice this time.
        twice: Share that arrives twice.
    """

    lost: float = 0.0
    jitter_ns: int = 0
    twice: float = 0.0


def arrivals(
    seconds: float, journey: Journey, *, seed: int, host_ahead_ns: int, session: int = 1
) -> list[tuple[int, bytes]]:
    """Frame messages of a sensor at 30 fps and when each arrives, in the order of their capture.

    Delays are 1 ms and up to twice the jitter, so that a frame can overtake the one before it.
    """
    rng, sent = np.random.default_rng(seed), list[tuple[int, bytes]]()
    for sequence in range(round(30 * seconds)):
        captured_ns = 1_000_000_000 + round(sequence * 1e9 / 30)
        frame = SensorFrame(captured_ns, host_ns=captured_ns + host_ahead_ns)
        data = encode_frame(FrameMessage(session, sequence, frame, captured_ns + host_ahead_ns))
        lost, twice = rng.random(2)
        for copy in range(1 + (twice < journey.twice)):
            delay_ns = 1_000_000 + round(rng.uniform(0.0, 2.0 * journey.jitter_ns)) + copy * 5_000_000
            if lost >= journey.lost:
                sent.append((captured_ns + delay_ns, data))
    return sent
