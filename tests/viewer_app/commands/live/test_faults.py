"""Faults of sensors and trackers during ``duplex live``: the session goes on and is saved."""

from __future__ import annotations

import gc
import json
import os
import signal
import threading
from pathlib import Path

import pytest

from devices.azure.tracking.body_tracker import BodyTracker
from recordings.file.rrd_file import read_columns
from tests.helpers.live_program import Live
from tests.helpers.session_text import events_of, rows_of
from tests.helpers.standin_library import Standin
from tests.helpers.standin_pyk4a import Bus


def test_unplugged_mid_stream(kinects: Bus, live: Live) -> None:
    a, b = kinects.devices  # A is the subordinate: without its master no other gives frames
    a.at[15] = lambda: setattr(a, "plugged", False)
    said = live(seconds=1.6)
    assert "Kinect 000123 was unplugged or lost its power" in said
    told = [text for text in events_of(live.saved) if "000123" in text]
    assert "unplugged" in told[0]
    assert "Going on without it" in told[0]
    # B gives about 48 frames, until the end; 15 of them are paired with A
    assert rows_of(live.saved, "/fused/skeleton") >= 0.6 * b.captures > 15
    assert kinects.open_serials == []


def test_unplugged_and_plugged_in_again(kinects: Bus, live: Live) -> None:
    a, b = kinects.devices
    a.at[10] = lambda: setattr(a, "plugged", False)
    b.at[20] = lambda: setattr(a, "plugged", True)
    live(seconds=2.4)  # a lost sensor is tried again every second
    told = [text for text in events_of(live.saved) if "000123" in text]
    assert ["unplugged" in told[0], "is back" in told[-1]] == [True, True]
    assert a.captures > 15
    assert kinects.failed_opens <= 2, "one that is not there is not opened"


def test_both_unplugged_end_when_asked(kinects: Bus, live: Live) -> None:
    for device in kinects.devices:
        device.at[8] = lambda device=device: setattr(device, "plugged", False)
    said = live(seconds=0.8)
    assert said.count("was unplugged") == 2, "said at once, though no frame comes"
    assert len([text for text in events_of(live.saved) if "unplugged" in text]) == 2
    assert rows_of(live.saved, "/fused/skeleton") >= 5


def test_stream_stalls(kinects: Bus, live: Live) -> None:
    a, b = kinects.devices
    b.at[10] = lambda: setattr(b, "silent", True)
    assert "000456 stalls: no frame for 2 s" in live(seconds=2.8)
    assert any("stalls" in text for text in events_of(live.saved))
    assert rows_of(live.saved, "/fused/skeleton") >= 0.7 * a.captures > 10, "A goes on"


def test_tracker_crashes_to_an_error_code(kinects: Bus, live: Live, standin: Standin) -> None:
    a, _ = kinects.devices
    a.at[10] = lambda: setattr(standin, "pop_status", 1)
    a.at[12] = lambda: setattr(standin, "pop_status", 0)
    live(seconds=2.0)
    told = events_of(live.saved)
    assert any("The body tracker failed (status 1)" in text for text in told)
    assert any("is back" in text for text in told)


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


def test_tracker_hangs_at_close(
    kinects: Bus, live: Live, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    release, hung, close = threading.Event(), [], BodyTracker.close

    def hang(tracker: BodyTracker) -> None:
        if tracker._library is not None and not hung:  # the library of the sensor that closes first
            hung.append(tracker)
            release.wait(60.0)
        close(tracker)

    monkeypatch.setattr(BodyTracker, "close", hang)
    report = tmp_path / "report.json"
    assert "does not close; it is left behind" in live("--report", report, seconds=0.5)
    assert rows_of(live.saved, "/fused/skeleton") > 0
    release.set()
    for thread in threading.enumerate():
        if thread.name.startswith("sensor "):
            thread.join(60.0)
    assert kinects.open_serials == []


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


def test_a_slow_tracker_halves_the_rate_of_both_and_is_named(
    kinects: Bus, live: Live, standin: Standin
) -> None:
    standin.tracking_ms = 60
    said = live(seconds=2.5)
    assert "frames per second. It is the tracker, not USB or light" in said
    assert any("It is the tracker" in text for text in events_of(live.saved))
    assert min(device.captures for device in kinects.devices) > 30, "the cameras go on at full rate"
    assert 0 < rows_of(live.saved, "/fused/skeleton") < 0.8 * kinects.devices[0].captures


def test_frames_lost_before_a_slow_tracker_are_reported(kinects: Bus, live: Live, tmp_path: Path) -> None:
    _, b = kinects.devices
    b.at[5] = lambda: setattr(b, "clock_usec", b.clock_usec + 40 * b.interval_usec)
    report = tmp_path / "report.json"
    said = live("--report", report)
    figures = json.loads(report.read_text(encoding="utf-8"))
    assert figures["streams"]["too_slow_for"]["b"] >= 40
    assert figures["dropped"]["b"] >= 40
    assert "frames of B dropped (too slow) 4" in said
    counted = read_columns(live.saved, lambda entity: entity == "/quality/dropped").values
    assert counted["/quality/dropped", "Scalars:scalars"][1][-1, 1] >= 40


@pytest.mark.skipif(not hasattr(os, "kill"), reason="needs POSIX signals")
@pytest.mark.parametrize("capture", [0, 1, 12])
def test_ctrl_c_ends_it_and_everything_is_saved(kinects: Bus, live: Live, capture: int) -> None:
    a, _ = kinects.devices
    a.at[capture] = lambda: os.kill(os.getpid(), signal.SIGINT)
    said = live(seconds=20.0, codes=(0, 130))
    assert kinects.open_serials == []
    if said == "duplex: stopped\n" or "no frame was received" in said:
        # it came while the second sensor was still being opened: nothing was captured
        assert capture < 12
        assert not live.saved.exists()
        return
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert "Saved" in said
    assert rows_of(live.saved, "/fused/skeleton") >= max(capture - 5, 1)
