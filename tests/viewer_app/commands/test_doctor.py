"""``duplex doctor`` on a bare machine and where ``duplex live`` can start."""

import io
import json
import os
import re
import signal
import sys
import zipfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices.azure.calibration import depth_intrinsics
from devices.azure.mkv import MkvRecording
from devices.check import Check, failed
from devices.live import checks as device_doctor
from devices.sensor import DeviceError
from tests.helpers import standin_pyk4a
from tests.helpers.command_line import duplex, one_line
from tests.helpers.displays import x_server
from tests.helpers.machine import need_viewer, small_disk
from tests.helpers.standin_pyk4a import Device
from tests.helpers.usb_tree import furnish, plug_in
from viewer_app.commands import doctor
from viewer_app.commands.doctor import _graphics, report_lines
from viewer_app.sensors.anonymity import Anonymity
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


# --- ``duplex doctor --bundle``: all that a maintainer needs, and nothing that tells whose it is.


USER, HOST, OTHER, FOLDER = "quillon", "lab-zorba-7", "mesa-kirk-3", "Xanadu"
NUMBERS = ("000123", "000456", "778899001122", "AB12CD34EF")
PLANTED = (USER, HOST, OTHER, "Zaphira", "Quex", FOLDER, "Lagash", *NUMBERS)
UUID = "6fe10177-90d1-4b6e-93a1-1f0000a1b2c3"
KINDS = {  # what stands in a text, and the words of it that must not
    "sensors": ("Kinect 000123 and 000456", ["000123", "000456"]),
    "library": (f"/srv/{FOLDER}/libk4a.so.1.4", [FOLDER]),
    "user": (USER, [USER]),
    "account": (f"{USER}@{HOST}", [USER, HOST]),
    "given name": ("Zaphira", ["Zaphira"]),
    "surname": ("Quex", ["Quex"]),
    "host": (OTHER, [OTHER]),
    "host in full": (f"{OTHER}.example.org", [OTHER]),
    "display": (f"{HOST}:10.0", [HOST]),
    "home": (f"/home of/{USER}/notes.txt", [USER, "notes"]),
    "file beside": (f"/srv/{FOLDER}/a b/patient.bin", [FOLDER, "patient"]),
    "path with a stop": ("/srv/Dr. Vorlund/models", ["Vorlund"]),
    "file with a stop": ("/srv/Dr. Vorlund/models/libx.so.1", ["Vorlund"]),
    "known folder's part": ("Lagash", ["Lagash"]),
    "relative path": ("patients/vorlund/walk.mkv", ["patients", "vorlund"]),
    "file in a folder": ("vorlund/walk.mkv", ["vorlund"]),
    "path from here": ("../vorlund", ["vorlund"]),
    "path from home": ("~vorlund/walk", ["vorlund"]),
    "drive": (f"D:\\{FOLDER}\\vorlund.dat", [FOLDER, "vorlund"]),
    "share": (f"\\\\{HOST}\\vorlund\\x.dat", [HOST, "vorlund"]),
    "file URL": ("file:///srv/vorlund/x.html", ["vorlund"]),
    "URL": ("http://nas.vorlund.example:8080/a?token=hunter2", ["vorlund", "hunter2"]),
    "URL with a password": ("ftp://vorlund:hunter2@nas.example/x", ["vorlund", "hunter2", "nas"]),
    "locator": ("tcp/nas-vorlund:7447", ["vorlund"]),
    "mail": ("jane.vorlund@example.com", ["vorlund", "jane"]),
    "IPv4": ("192.168.17.42", ["192.168", "17.42"]),
    "IPv4 and port": ("tcp/192.168.17.42:7447", ["192.168", "17.42"]),
    "IPv6": ("fe80::1ff:fe23:4567:890a", ["fe23", "890a"]),
    "IPv6 in full": ("2001:db8:0:0:8:800:200c:417a", ["200c", "417a"]),
    "MAC": ("00:1a:2b:3c:4d:5e", ["3c:4d"]),
    "MAC with dashes": ("00-1A-2B-3C-4D-5E", ["3C-4D"]),
    "MAC of routers": ("001a.2b3c.4d5e", ["2b3c"]),
    "serial": ("Serial number: 778899001122", ["778899001122"]),
    "S/N": ("S/N: AB-778899-X", ["778899"]),
    "SN": ("SN 778899001122", ["778899001122"]),
    "serial in JSON": ('"SerialId":"AB12CD34EF"', ["AB12CD34EF"]),
    "UUID": (UUID, [UUID]),
    "machine id": ("5e0f1c2b3a4d5e6f708192a3b4c5d6e7", ["5e0f1c2b"]),
}
SENTENCES = (
    "{}",
    "({})",
    "'{}'",
    "at {}, no",
    "a={};b",
    "Cannot open {}. Plug it in.",
    "x\n{}\ny",
    "{}: denied",
)


def plant(monkeypatch, tmp_path):
    """Plants the person's traces wherever the program may look."""
    home = tmp_path / "home of" / USER
    secret = home / FOLDER
    (secret / "models").mkdir(parents=True)
    for name, value in (
        *(("HOME", home), ("USER", USER), ("LOGNAME", USER), ("USERNAME", USER), ("HOSTNAME", HOST)),
        *(("DISPLAY", f"{HOST}:0"), ("XAUTHORITY", secret / "X authority"), ("SUDO_USER", USER)),
    ):
        monkeypatch.setenv(name, str(value))
    monkeypatch.setattr("socket.gethostname", lambda: f"{OTHER}.example.org")
    monkeypatch.setattr("platform.node", lambda: OTHER)
    monkeypatch.setenv("LD_LIBRARY_PATH", f"/srv/{FOLDER} (of Lagash)/lib:/opt")
    if sys.platform != "win32":
        monkeypatch.setattr("pwd.getpwuid", lambda _: type("Entry", (), {"pw_gecos": "Zaphira B. Quex,,,"}))
    monkeypatch.chdir(secret)


def checks_that_tell():
    """Findings with a trace of every kind, which libraries print and log, too."""
    for trace, _ in KINDS.values():
        os.write(2, f"from a library: {trace}\n".encode())
        print("from Python:", trace, file=sys.stderr)
        with Path(os.environ["K4A_ENABLE_LOG_TO_A_FILE"]).open("a", encoding="utf-8") as log:
            log.write(f"from libk4a: {trace}\n")
        fault = DeviceError(f"The library cannot open {trace}. Its advice is {trace}, too.")
        yield failed(f"a check of {trace}", fault, needed=False)
        yield Check("b", True, trace, serves=trace, install=trace)


def contents(path):
    """The files of a bundle."""
    with zipfile.ZipFile(path) as file:
        assert file.testzip() is None
        return {name: file.read(name) for name in file.namelist()}


def told(members, words):
    """Which of the words are in a bundle's texts, also where JSON escapes them."""
    texts = {name: content.decode() for name, content in members.items() if not name.endswith(".mkv")}
    texts["as JSON"] = json.dumps(json.loads(texts["doctor.json"]))
    return [(name, word) for name, text in texts.items() for word in words if word.lower() in text.lower()]


@pytest.fixture
def traces(monkeypatch, tmp_path):
    plant(monkeypatch, tmp_path)


@pytest.fixture
def planted(traces, kinects, standin, monkeypatch):
    """A run of ``duplex doctor`` on two sensors, with the traces in findings, logs and calibrations."""

    def calibration_json(*given):
        inside = json.loads(calibration(*given))
        inside["CalibrationInformation"]["Metadata"] = {"SerialId": "AB12CD34EF"}
        return json.dumps(inside).encode() + b"\0"

    calibration = standin_pyk4a.calibration_json
    monkeypatch.setattr(standin_pyk4a, "calibration_json", calibration_json)
    monkeypatch.setattr(doctor, "device_checks", lambda *_, **__: list(checks_that_tell()))
    monkeypatch.setattr(doctor, "program_checks", list)
    monkeypatch.setattr(doctor, "SECONDS", 1.0)
    for library in ("K4A", "K4ABT"):
        monkeypatch.setenv(f"{library}_ENABLE_LOG_TO_A_FILE", "")
        monkeypatch.setenv(f"{library}_LOG_LEVEL", "")
    assert traces is None
    assert len(kinects.devices) == 2
    return lambda *given: duplex("doctor", "--k4abt", standin.path, *given)


def test_nothing_in_it_tells_whose_it_is(planted, tmp_path, capfd):
    path = tmp_path / "b.zip"
    assert planted("--bundle", path, "--recording") == 0
    said = capfd.readouterr()
    assert "000123" in said.out, "the person may see it"
    assert said.err == ""
    members = contents(path)
    assert sorted(members) == ["a.mkv", "b.mkv", "doctor.json", "doctor.txt", "log.txt"]
    for name, content in members.items():
        for trace in (*PLANTED, UUID, str(tmp_path)):
            for coded in (trace.encode(), trace.encode("utf-16-le")):
                assert coded.lower() not in content.lower(), (name, trace)
    text, log = members["doctor.txt"].decode(), members["log.txt"].decode()
    for words in ("from a library:", "from Python:", "from libk4a:", "\na.mkv: ", "Sync cable: B leads"):
        assert words in log, log
    assert "libk4a.so.1.4" in text, "which library it was"
    assert "duplex live can start. Next: " in text.splitlines()[-1]
    assert not [each for each in tmp_path.iterdir() if each.name.startswith(".duplex")]
    serials = []
    for name in ("a.mkv", "b.mkv"):
        (tmp_path / name).write_bytes(members[name])
        with MkvRecording(tmp_path / name) as recording:
            assert len(list(recording.frames())) > 5
            assert recording.warnings == []
            assert recording.info.intrinsics.cx == pytest.approx(332.0), "the sensor's own calibration"
            assert b"sensor-" in recording.info.calibration_json
            serials.append(recording.info.serial)
    assert len(set(serials)) == 2
    findings = json.loads(members["doctor.json"])
    assert all(serial in findings["checks"][0]["detail"] for serial in serials), "the same hash everywhere"
    assert told(members, {word for _, words in KINDS.values() for word in words}) == []
    versions = findings["versions"]
    assert {"duplex-kinects", "numpy", "av"} <= set(versions["packages"])
    assert sys.version.split()[0] in versions["python"]
    assert planted("--bundle", path, "--force") == 0
    assert serials[0] not in contents(path)["doctor.txt"].decode(), "another bundle has other hashes"


def test_nothing_is_recorded_unasked(planted, tmp_path, monkeypatch, capsys):
    path, answers = tmp_path / "b.zip", iter(["y", "n", ""])
    assert planted("--bundle", path) == 0
    assert "up to 350 MB, in which you and the room can be seen" in " ".join(capsys.readouterr().out.split())
    assert "a.mkv" not in contents(path)
    monkeypatch.setattr("sys.stdin", type("Terminal", (io.StringIO,), {"isatty": lambda _: True})())
    monkeypatch.setattr("builtins.input", lambda *_: next(answers))
    for wanted in (True, False, False):
        assert planted("--bundle", path, "--force") == 0
        assert ("a.mkv" in contents(path)) is wanted
    assert planted("--bundle", path, "--force", "--no-recording") == 0, "and is not asked"


def test_a_sensor_that_is_plugged_in_later_is_hidden_too(planted, kinects, monkeypatch, tmp_path):
    path, later = tmp_path / "b.zip", list(kinects.devices)
    kinects.devices.clear()
    examine = doctor.device_checks

    def device_checks(*given, **named):
        kinects.devices.extend(later)
        return examine(*given, **named)

    monkeypatch.setattr(doctor, "device_checks", device_checks)
    assert planted("--bundle", path, "--recording") == 0
    for name, content in contents(path).items():
        assert not [serial for serial in (b"000123", b"000456") if serial in content], name


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has neither signal")
@pytest.mark.parametrize("name", ["SIGHUP", "SIGTERM"])
def test_a_closed_terminal_leaves_nothing(planted, monkeypatch, tmp_path, name):
    number, folder = getattr(signal, name), tmp_path / "to"
    folder.mkdir()

    def die():
        os.kill(os.getpid(), number)
        return []

    monkeypatch.setattr(doctor, "program_checks", die)
    before = signal.signal(number, signal.default_int_handler)  # as the console script does
    try:
        assert planted("--bundle", folder / "b.zip") == 130
    finally:
        signal.signal(number, before)
    assert list(folder.iterdir()) == []


def test_sensors_that_do_not_record_are_a_finding(planted, kinects, tmp_path):
    kinects.devices.pop()
    assert planted("--bundle", tmp_path / "b.zip", "--recording") == 0
    members = contents(tmp_path / "b.zip")
    assert sorted(members) == ["doctor.json", "doctor.txt", "log.txt"]
    assert "Only one sensor is connected, sensor-" in members["log.txt"].decode()


def test_a_full_disk_leaves_nothing(planted, tmp_path, capsys):
    with small_disk(tmp_path / "small", 400) as disk:
        assert planted("--bundle", disk / "b.zip", "--recording") == 2
        assert "b.zip could not be written: No space left on device" in one_line(capsys)
        assert list(disk.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "hidden"),
    [
        ("udev rule in /etc/udev/rules.d/99-k4a.rules.", "udev rule in <path>/99-k4a.rules."),
        ("/dev/bus/usb/002/007 (denied). Unplug it and/or wait", "<path> (denied). Unplug it and/or wait"),
        ("300/300 frames, 640 × 480 / 30 fps, 1.5 m/s", "300/300 frames, 640 × 480 / 30 fps, 1.5 m/s"),
        ("https://github.com/orbbec/x/issues/38", "https://github.com/orbbec/x/issues/38"),
        ("file:///srv/me/a.so; C:\\Users\\Me You\\a.dll: no", "<path>/a.so; <path>/a.dll: no"),
        ("//server/share/Jane/x.txt, \x1b[1m/srv/me\x1b[0m", "<path>, <path>"),
        ("\\\\?\\C:\\Users\\Jane\\a.dll: no", "<path>/a.dll: no"),
        ("/srv/Jane Doe.txt was found, /srv/me too", "<path> was found, <path> too"),
        ("serial numbers differ; serial number of one", "serial numbers differ; serial number of one"),
        ("LD_LIBRARY_PATH=/srv/me:/srv/you", "LD_LIBRARY_PATH=<path>:<path>"),
        ("at 12:34:56 libx 1.4.2 on 127.0.0.1:9090, ::1", "at 12:34:56 libx 1.4.2 on 127.0.0.1:9090, ::1"),
        ("std::runtime_error, USB 3 / xHCI, S/N unknown", "std::runtime_error, USB 3 / xHCI, S/N unknown"),
    ],
)
def test_what_tells_nothing_stays(text, hidden):
    assert Anonymity([])(text) == hidden


@pytest.mark.usefixtures("traces")
@pytest.mark.parametrize("kind", KINDS)
def test_traces_of_every_kind_are_hidden(kind):
    trace, words = KINDS[kind]
    hide = Anonymity(NUMBERS)
    for sentence in SENTENCES:
        hidden = hide(sentence.format(trace)).lower()
        assert not [word for word in words if word.lower() in hidden], hidden


def test_a_real_calibration_keeps_its_lens(shared):
    with MkvRecording(shared / "azure" / "recording.mkv") as recording:
        info = recording.info
    text = info.calibration_json.decode("latin-1")
    assert '"SerialId":"001514394512"' in text
    hidden = Anonymity([info.serial])(text)
    assert "001514394512" not in hidden
    was, now = (depth_intrinsics(each.encode("latin-1"), info.depth_mode) for each in (text, hidden))
    assert was == now
