"""Trackers slower than the cameras, colour later than depth: the table in ``docs/sensors.md``.

``python -m tests.campaigns.slow_trackers`` prints it: for each colour latency and tracker time the share of
the frames that both trackers could process that were paired, and the median age of the frames of a pair,
since they could be had from libk4a and (in brackets) since depth was on the host. In virtual time.
"""

from __future__ import annotations

import sys
from unittest import mock

from tests.helpers.slow_trackers import run_slow_trackers
from tests.helpers.standin_pyk4a import Bus, make_module

LATENCIES_MS = (0, 50, 100, 150, 200)
TRACKING_MS = ((20, 20), (40, 40), (60, 60), (20, 60))


def main() -> int:
    """The program."""
    print("| colour latency | " + " | ".join(f"trackers {a} and {b} ms" for a, b in TRACKING_MS) + " |")
    print("|---" * (1 + len(TRACKING_MS)) + "|")
    fine = True
    for latency_ms in LATENCIES_MS:
        cells = [f"{latency_ms} ms"]
        for tracking_ms in TRACKING_MS:
            bus = Bus(None)
            a_ns, b_ns = (1_000_000 * ms for ms in tracking_ms)
            with mock.patch.dict(sys.modules, {"pyk4a": make_module(bus)}):
                seen = run_slow_trackers(
                    bus, color_latency_ns=1_000_000 * latency_ms, tracking_ns=(a_ns, b_ns)
                )
            fine &= seen.paired >= 0.99 and seen.age_ns <= max(a_ns, b_ns) + 33_333_333
            ages = f"{seen.age_ns * 1e-6:.0f} ms ({seen.since_capture_ns * 1e-6:.0f})"
            cells.append(f"{min(1.0, seen.paired):.1%}, {ages}, {30 // seen.step} fps")
        print("| " + " | ".join(cells) + " |", flush=True)
    print("passed" if fine else "FAILED", file=sys.stderr)
    return 0 if fine else 1


if __name__ == "__main__":
    sys.exit(main())
