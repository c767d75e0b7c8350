"""Which sensors ``duplex live`` opens, how it pairs them, and what it refuses before it starts."""

import io
import sys

import pytest
from rich.console import Console

from devices.capture.sensor_choice import ConnectedSensor
from devices.capture.sensor_thread import SensorThread
from devices.capture.stream_pairing import LivePairing
from tests.helpers.command_line import duplex
from tests.helpers.sentences import check_sentences, refusals
from viewer_app.options.sensing import LiveOptions
from viewer_app.sensors.local import two_connected_sensors


def _pairing_settings(monkeypatch, **options):
    """The arguments that ``two_connected_sensors`` passes to the pairing."""
    given = {}

    def pairing(interval_ns, **more):
        given.update(interval_ns=interval_ns, **more)
        return LivePairing(interval_ns, **more)

    monkeypatch.setattr("viewer_app.sensors.local.LivePairing", pairing)
    two_connected_sensors(LiveOptions(**options), Console())
    return given


@pytest.mark.usefixtures("kinects")
@pytest.mark.parametrize(("principal", "b_later_ns"), [("000456", 160_000), ("000123", -160_000)])
def test_b_captures_later_where_a_leads_and_earlier_where_it_follows(principal, b_later_ns, monkeypatch):
    # the cable leads from 000456 to 000123
    assert _pairing_settings(monkeypatch, principal=principal)["sync_delay_ns"] == b_later_ns


def test_a_realsense_captures_at_its_masters_pulse(monkeypatch):
    two = [
        ConnectedSensor(k, serial, False, False, sdk="realsense", tells_jacks=False)
        for k, serial in enumerate(("1001", "1002"))
    ]
    monkeypatch.setattr("devices.live.sensors.connected_sensors", lambda _: two)
    options = {"principal": "1001", "sync_master": "1002", "tracker": "blazepose"}
    assert _pairing_settings(monkeypatch, **options)["sync_delay_ns"] == 0


@pytest.mark.parametrize("fps", [5, 15, 30])
def test_pairing_has_the_interval_of_the_cameras(kinects, monkeypatch, fps):
    for device in kinects.devices:
        device.jacks = (False, False)
    given = _pairing_settings(monkeypatch, principal="000123", fps=fps)
    assert given == {"sync_delay_ns": None, "interval_ns": round(1e9 / fps)}


@pytest.mark.parametrize(("processing", "within_s"), [("gpu", 120.0), ("tensorrt", 900.0)])
@pytest.mark.usefixtures("kinects")
def test_tensorrt_has_time_to_build_its_engine(processing, within_s, monkeypatch, capsys):
    given = []

    def open_thread(thread):
        given.extend((thread._limits.open_s, thread.sensor.settings.start_s))
        return thread

    monkeypatch.setattr(SensorThread, "open", open_thread)
    options = LiveOptions(kinect_a="000123", kinect_b="000456", processing=processing, tracker="k4abt")
    with two_connected_sensors(options, Console()):
        assert given == [within_s] * 4
    assert ("TensorRT builds its engine, which" in capsys.readouterr().out) == (processing == "tensorrt")


@pytest.mark.parametrize(("answer", "principal"), [("1\n", "000123"), ("x\n\n000456\n", "000456")])
@pytest.mark.usefixtures("kinects")
def test_it_asks_which_is_which(standin, answer, principal, monkeypatch, capsys):
    terminal = io.StringIO(answer)
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stdin", terminal)
    assert duplex("live", "--k4abt", standin.path, "--no-viewer", "--seconds", 0.2) == 0
    said = capsys.readouterr().out
    assert f"Next time: --principal {principal}" in said
    assert f"Opening {principal} (A)" in said


@pytest.mark.usefixtures("kinects")
def test_sentences_of_live(tmp_path, monkeypatch, capsys):
    """Before any sensor opens."""
    monkeypatch.setattr(SensorThread, "open", lambda _: pytest.fail("it opens"))
    monkeypatch.setattr(sys, "stdin", io.StringIO(""))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken.rrd").touch()
    check_sentences("live", refusals(capsys, tmp_path))
