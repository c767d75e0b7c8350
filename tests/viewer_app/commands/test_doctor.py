"""``duplex doctor`` on a bare machine and where ``duplex live`` can start."""

import sys

from devices import live_checks as device_doctor
from tests.helpers.command_line import duplex
from tests.helpers.displays import x_server
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish, plug_in
from viewer_app.viewer import display


def test_the_doctor_of_a_bare_machine_fails(monkeypatch, tmp_path, capsys):
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    monkeypatch.setitem(sys.modules, "pyorbbecsdk", None)
    assert duplex("doctor", "--k4abt", tmp_path / "none.so") == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("✗ pyk4a and the Sensor SDK: ")
    assert any(line.startswith(f"✗ k4abt: No library at {tmp_path}") for line in said)
    assert any(line.startswith("✓ viewer: rerun 0.") for line in said)
    assert said[-1].startswith(
        "duplex live cannot start: pyk4a and the Sensor SDK or pyorbbecsdk2 (Orbbec's SDK v2) or "
        "libfreenect 0.5 (Kinect v1) or libfreenect2 (Kinect v2) or pyrealsense2, "
    )
    assert said[-1].count("pyorbbecsdk2") == 1, "one of them is enough"
    assert "depth engine" not in said[-1], "which of them needs it is not known yet"
    assert ", k4abt, " in said[-1]
    assert all(line[:2] in ("✓ ", "✗ ", "– ") for line in said[:-1]), "one line each"


def test_the_doctor_says_0_where_live_starts(kinects, live, standin, monkeypatch, tmp_path, capsys):
    monkeypatch.setenv("DISPLAY", ":77")
    furnish(tmp_path)
    for number, device in enumerate(kinects.devices):
        plug_in(tmp_path, device.serial, number=number)
    checks = device_doctor.device_checks
    monkeypatch.setattr(
        "viewer_app.commands.doctor.device_checks", lambda of, **more: checks(of, tmp_path, **more)
    )
    if sys.platform.startswith("linux"):
        monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")  # windows use Wayland; the depth engine uses X
        assert duplex("doctor", "--k4abt", standin.path) == 1
        assert "cannot start: depth engine.\n" in capsys.readouterr().out
    monkeypatch.setattr(display, "_asks_x", lambda name: name == ":77")
    assert duplex("doctor", "--k4abt", standin.path) == 0
    said = capsys.readouterr().out
    assert "✓ two Kinects: 2 connected, 2 usable" in said
    assert "✓ sync cable: from 000456 to 000123" in said
    assert "never a real sensor" in said
    assert said.endswith("duplex live can start.\n")
    live(seconds=0.2)
    kinects.devices.append(Device("000789"))
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "cannot start: two Kinects.\n" in capsys.readouterr().out
    assert duplex("doctor", "--k4abt", standin.path, "--kinect-a", "000123", "--kinect-b", "000456") == 0
    kinects.devices.pop().plugged = False
    kinects.devices[0].jacks = (False, False)
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "joins no sync out to a sync in" in capsys.readouterr().out
    live("--force", seconds=0.2, codes=(2,))


def test_a_display_that_answers_is_a_tick_for_the_window_and_for_the_depth_engine(
    monkeypatch, tmp_path, capsys
):
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with x_server() as name:
        monkeypatch.setenv("DISPLAY", name)
        duplex("doctor", "--k4abt", tmp_path / "none.so")
        said = capsys.readouterr().out
    assert f"✓ display: {name}\n" in said
    assert "does not answer" not in said
