"""Faults of sensors and trackers during ``duplex live``: the session goes on and is saved."""

from __future__ import annotations

import gc

from tests.helpers.live_program import Live
from tests.helpers.session_text import events_of, rows_of
from tests.helpers.standin_pyk4a import Bus


def test_driver_raises_what_no_one_expects(kinects: Bus, live: Live) -> None:
    def oddity() -> None:
        raise RuntimeError("driver oddity")

    kinects.devices[0].at[20] = oddity
    said = live(seconds=20.0, codes=(2,))
    assert said.startswith(
        "duplex: 000123 failed within its driver or this program (RuntimeError: driver oddity)"
    )
    assert said.count("\n") == 1
    assert rows_of(live.saved, "/fused/skeleton") >= 5
    assert kinects.open_serials == []
    gc.collect()  # the error's traceback holds the last capture


def test_one_sensor_5_fps_slower(kinects: Bus, live: Live) -> None:
    a, b = kinects.devices
    b.interval_usec = 40_000
    said = live("--verbose", seconds=1.5)
    # every frame of A is fused, five of six with B
    fused = rows_of(live.saved, "/fused/skeleton")
    assert fused >= 0.7 * a.captures
    pairs = int(said[said.index("Paired") :].split()[1])
    assert 0.6 <= pairs / fused < 1.0
    assert not any("000" in text for text in events_of(live.saved)), "no event of a sensor"
