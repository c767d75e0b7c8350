"""Two sensors' frames with known truth: when each was captured, what its clock said, when it arrived."""

from dataclasses import dataclass

import numpy as np

from devices.capture.stream_pairing import Side
from devices.sensor import SensorFrame

INTERVAL_NS = 33_333_333
SECOND_NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Shot:
    """A frame and its truth, all in ns; ``true_ns`` and ``arrives_ns`` are by the host's clock."""

    side: Side
    true_ns: int
    arrives_ns: int
    frame: SensorFrame


def shots(side, seconds, *, fps=30.0, phase_ns=0, clock_ns=0, ppm=0.0, latency_ns=20_000_000, seed=1):
    """A sensor's frames: clock = (true time)(1 + ppm) + clock_ns; delays are latency + 3 ms of jitter."""
    rng = np.random.default_rng(seed + (side == "b"))
    result = []
    for index in range(int(seconds * fps)):
        true_ns = 5 * SECOND_NS + phase_ns + round(index * SECOND_NS / fps)
        delay = latency_ns + min(round(rng.exponential(3_000_000)), 25_000_000)
        said_ns = round(true_ns * (1 + ppm * 1e-6)) + clock_ns
        arrives_ns = true_ns + delay
        result.append(Shot(side, true_ns, arrives_ns, SensorFrame(said_ns, host_ns=arrives_ns)))
    return result


def run(pairing, *streams):
    """Feeds frames in the order of their arrival, with a poll every 10 ms as the loop does."""
    todo = sorted((shot for stream in streams for shot in stream), key=lambda shot: shot.arrives_ns)
    pairs, now_ns = [], todo[0].arrives_ns
    for shot in todo:
        while now_ns + 10_000_000 < shot.arrives_ns:
            now_ns += 10_000_000
            pairs += pairing.poll(now_ns)
        now_ns = shot.arrives_ns
        pairs += pairing.add(shot.side, shot.frame, now_ns)
    return pairs + pairing.poll(now_ns + SECOND_NS)


def true_skews(pairs, *streams):
    """True time between the captures of each pair's frames, ns."""
    truth = {id(shot.frame): shot.true_ns for stream in streams for shot in stream}
    return np.array([truth[id(p.b)] - truth[id(p.a)] for p in pairs if p.a is not None and p.b is not None])
