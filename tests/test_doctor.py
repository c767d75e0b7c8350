"""What the doctor finds on machines made up by the tests."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from standin import Standin
from standin_pyk4a import Bus, Device

from devices.body_tracking import TrackerSettings
from devices.doctor import Check, device_checks
from devices.usb import usb_kinects


def _by_name(checks: list[Check]) -> dict[str, Check]:
    named = {check.name: check for check in checks}
    assert len(named) == len(checks)
    return named


def plug_in(
    root: Path, serial: str = "000123", product: str = "097c", speed: int = 5000, number: int = 7
) -> Path:
    """Puts a depth camera on a made-up machine's bus, as Linux shows it."""
    entry = root / "sys/bus/usb/devices" / f"2-{number}"
    entry.mkdir(parents=True)
    content = {
        "idVendor": "045e",
        "idProduct": product,
        "serial": serial,
        "busnum": "2",
        "devnum": str(number),
        "speed": str(speed),
    }
    for name, text in content.items():
        (entry / name).write_text(text + "\n")
    node = root / "dev/bus/usb/002" / f"{number:03d}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return node


@pytest.fixture
def forbidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every device file refused, also to root."""
    monkeypatch.setattr(os, "access", lambda *_: False)


def test_a_bare_machine_needs_everything_and_every_failure_has_advice(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pyk4a", None)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    checks = device_checks(TrackerSettings(library=tmp_path / "libk4abt.so"), tmp_path)
    named = _by_name(checks)
    for name in (
        "pyk4a and the Sensor SDK",
        "body tracker",
        "body tracker's network",
        "USB permission",
        "two Kinects",
    ):
        assert not named[name].ok, name
        assert named[name].needed, name
    assert all(check.advice for check in checks if not check.ok)
    assert "duplex-kinects[kinect]" in named["pyk4a and the Sensor SDK"].advice


def test_a_machine_with_all_of_it_can_start(bus: Bus, standin: Standin, tmp_path: Path) -> None:
    bus.devices = [Device("000123", jacks=(False, True)), Device("000456", jacks=(True, False))]
    (tmp_path / "usr/bin").mkdir(parents=True)
    (tmp_path / "usr/bin/dnn_model_2_0_op11.onnx").touch()
    for number, serial in enumerate(("000123", "000456")):
        plug_in(tmp_path, serial, number=number)
    checks = device_checks(TrackerSettings(library=standin.path), tmp_path)
    assert [check.name for check in checks if check.needed and not check.ok] == []
    named = _by_name(checks)
    assert named["Kinect 000123"].detail == "sync in empty, sync out connected"
    assert named["Kinect 000456"].detail == "sync in connected, sync out empty"


def test_it_says_what_has_never_met_hardware(bus: Bus, tmp_path: Path) -> None:
    assert bus.devices == []
    unproven = _by_name(device_checks(root=tmp_path))["proven on hardware"]
    assert "never a real sensor" in unproven.detail
    assert not unproven.needed


def test_one_kinect_is_not_enough(bus: Bus, tmp_path: Path) -> None:
    bus.devices = [Device("000123"), Device("000456", busy=True)]
    named = _by_name(device_checks(root=tmp_path))
    assert not named["two Kinects"].ok
    assert named["two Kinects"].detail == "2 connected, 1 usable"
    assert "busy" in named["Kinect at place 1"].detail
    assert "k4aviewer" in named["Kinect at place 1"].advice


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="only Linux restricts USB devices")
@pytest.mark.usefixtures("forbidden")
def test_missing_usb_permission_names_the_rule(tmp_path: Path) -> None:
    node = plug_in(tmp_path)
    check = _by_name(device_checks(root=tmp_path))["USB permission"]
    assert not check.ok
    assert str(node) in check.detail
    assert "99-k4a.rules" in check.advice


def test_a_usb_2_port_is_told(tmp_path: Path) -> None:
    plug_in(tmp_path, speed=480)
    check = _by_name(device_checks(root=tmp_path))["USB speed"]
    assert (check.ok, check.detail) == (False, "000123 runs at 480 Mbit/s")


def test_the_bus_shows_depth_cameras_only(tmp_path: Path) -> None:
    plug_in(tmp_path, number=1)
    plug_in(tmp_path, product="097d", number=2)  # the colour camera of the same Kinect
    (kinect,) = usb_kinects(tmp_path)
    assert (kinect.serial, kinect.megabits, kinect.allowed) == ("000123", 5000, True)
    assert kinect.node.name == "001"
