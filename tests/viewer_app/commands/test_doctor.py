"""``duplex doctor`` on a bare machine and where ``duplex live`` can start."""

import os
import re
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.check import Check
from devices.live import checks as device_doctor
from tests.helpers.command_line import duplex
from tests.helpers.displays import x_server
from tests.helpers.machine import need_viewer
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish, plug_in
from viewer_app.commands.doctor import _graphics, report_lines
from viewer_app.viewer import display


@st.composite
def checks(draw):
    """Checks of any machine: names differ, and a failure that is needed has advice."""
    words = st.text("abc .\n", min_size=1, max_size=8)
    made = []
    for number in range(draw(st.integers(1, 8))):
        about, ok = draw(st.sampled_from(["sensor", "library", "machine"])), draw(st.booleans())
        missing = not ok and about == "library" and draw(st.booleans())
        needed = about != "library" and draw(st.booleans())
        made.append(
            Check(
                *(f"name {number}", ok, draw(words), "" if ok else f"Do {number}.", needed),
                *(about, missing, f"sensors {number}", f"install {number}"),
            )
        )
    return made


@given(checks())
def test_a_report_has_sensors_first_then_what_works_then_what_is_missing(made):
    lines = report_lines(made)
    plain = [line.plain for line in lines]
    assert not any("\n" in line for line in plain)
    assert sum("Next: " in line for line in plain) == 1
    failing = [check for check in made if check.needed and not check.ok]
    assert ("cannot start" in " ".join(plain)) is bool(failing)
    if failing:
        assert plain[-1].startswith("Works now: ")
        assert any(plain[-1].endswith(f"Next: {check.advice}") for check in failing)
    else:
        assert plain[-1].startswith("duplex live can start. Next: duplex live ")

    def place(check):
        begins = f"– {check.serves}: {check.install}" if check.missing else f" {check.name}:"
        (found,) = (k for k, line in enumerate(plain) if begins in line)
        return found

    order = [lambda c: c.about == "sensor", lambda c: c.ok and c.about == "library", lambda c: not c.missing]
    rank = {c.name: next((k for k, holds in enumerate(order) if holds(c)), len(order)) for c in made}
    by_place = sorted(made, key=place)
    assert [rank[check.name] for check in by_place] == sorted(rank.values())
    for check in made:
        mark = "✓" if check.ok else "✗" if check.needed else "–"
        assert plain[place(check)].startswith(mark)
        grey = "bright_black" in str(lines[place(check)].markup)
        assert grey or not (check.missing or (mark == "–" and check.about == "machine"))


@pytest.mark.usefixtures("no_libraries")
@pytest.mark.parametrize("made", [False, True])
def test_a_recording_without_sensors_leaves_the_disk_as_it_was(made, tmp_path):
    folder = tmp_path / "walk"
    if made:
        folder.mkdir()
    assert duplex("record", folder) == 2
    assert folder.exists() == made


@pytest.mark.usefixtures("no_libraries")
def test_a_first_run_without_sensors_is_short_and_leads_to_the_doctor(tmp_path, capsys):
    """At most three lines of a terminal's width."""
    for command in (("live", "--no-viewer"), ("record", tmp_path / "raw")):
        assert duplex(*command) == 2
        said = capsys.readouterr().err.splitlines()
        assert len(said) <= 3
        assert max(map(len, said)) <= 80
        assert {"Azure Kinect", "Orbbec", "Kinect v1", "Kinect v2", "RealSense"} <= set(
            re.split(", | or |\\.", said[1])
        )
        assert "Next: duplex doctor" in said[2]


@pytest.mark.usefixtures("no_libraries")
def test_the_doctor_of_a_bare_machine_fails(tmp_path, capsys):
    assert duplex("doctor", "--k4abt", tmp_path / "none.so") == 1
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("✗ two sensors: none found")
    assert any(line.startswith(f"✗ k4abt: No library at {tmp_path}") for line in said)
    assert any(line.startswith("✓ viewer: rerun 0.") for line in said)
    assert said[-2] == "duplex live cannot start. Missing: k4abt, k4abt's network, GPU, two sensors."
    assert said[-1].endswith("Next: Install the library of your sensors as its line above says.")
    assert sum(line.startswith("✗") for line in said) == 4, "one library is enough: none of them is a fault"


def test_the_doctor_says_0_where_live_starts(
    kinects, live, standin, closed_display, monkeypatch, tmp_path, capsys
):
    monkeypatch.setenv("DISPLAY", closed_display)
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
        assert "cannot start. Missing: depth engine.\n" in capsys.readouterr().out
    monkeypatch.setattr(display, "_asks_x", lambda name: name == closed_display)
    assert duplex("doctor", "--k4abt", standin.path) == 0
    said = capsys.readouterr().out
    assert "✓ two sensors: 2 connected, 2 usable" in said
    assert "✓ sync cable: from 000456 to 000123" in said
    assert "never with a real sensor" in said
    assert said.endswith("duplex live can start. Next: duplex live --save s.rrd\n")
    live(seconds=0.2)
    kinects.devices.append(Device("000789"))
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "cannot start. Missing: two sensors.\n" in capsys.readouterr().out
    assert duplex("doctor", "--k4abt", standin.path, "--kinect-a", "000123", "--kinect-b", "000456") == 0
    kinects.devices.pop().plugged = False
    kinects.devices[0].jacks = (False, False)
    assert duplex("doctor", "--k4abt", standin.path) == 1
    assert "joins no sync out to a sync in" in capsys.readouterr().out
    live("--force", seconds=0.2, codes=(2,))


def test_a_display_that_answers_is_a_tick_for_the_window_and_for_the_depth_engine(
    monkeypatch, tmp_path, capsys
):
    with x_server() as name:
        monkeypatch.setenv("DISPLAY", name)
        duplex("doctor", "--k4abt", tmp_path / "none.so")
        said = capsys.readouterr().out
    assert f"✓ display: {name}\n" in said
    assert "does not answer" not in said


def test_graphics_are_what_the_viewer_draws_with(monkeypatch):
    need_viewer()
    assert _graphics(Path("/")).ok
    monkeypatch.setenv("VK_DRIVER_FILES", os.devnull)
    monkeypatch.setenv("WGPU_BACKEND", "vulkan")
    check = _graphics(Path("/"))
    assert (check.ok, check.needed) == (False, False)
    assert "does not start here (" in check.detail, "in the viewer's own words"
