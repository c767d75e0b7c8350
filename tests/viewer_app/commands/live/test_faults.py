"""Faults of sensors and trackers during ``duplex live``: the session goes on and is saved."""

from __future__ import annotations

import gc
import json
from pathlib import Path

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


def test_frames_lost_on_usb_are_not_called_too_fast(kinects: Bus, live: Live, tmp_path: Path) -> None:
    _, b = kinects.devices
    b.at[5] = lambda: setattr(b, "clock_usec", b.clock_usec + 40 * b.interval_usec)
    report = tmp_path / "report.json"
    said = live("--report", report)
    streams = json.loads(report.read_text(encoding="utf-8"))["streams"]
    assert streams["lost_on_usb"]["b"] >= 40
    assert streams["too_slow_for"]["b"] < 40
    assert "frames of B lost on USB 4" in said
    assert "frames of B dropped" not in said
