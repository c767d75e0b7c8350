"""What an option names as a file is refused in one line where it is none."""

import os
import signal
import sys
from pathlib import Path
from typing import get_args

import pytest

from devices.cache import user_cache
from recordings.testing import simulated_session
from tests.helpers.command_line import duplex, kinds_of, needed, one_line, words_of
from tests.helpers.recorded_pairs import write_pair
from viewer_app.options.command_line import COMMANDS
from viewer_app.sensors.anonymity import Anonymity

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs POSIX files")

OUTPUTS = {"save", "report", "save_calibration", "html", "to", "out", "record", "folder", "bundle"}
ALSO_FILES = {"calibrate", "names"}  # words or files
ENDINGS = {
    "a": (".csv", ".json", ".skeleton", ".mkv", ".bag", ".db3"),
    "b": (".csv",),
    "session": (".rrd",),
    "recording": (".mkv", ".csv"),
    "first": (".rrd",),
    "second": (".rrd", ".c3d", ".trc", ".csv"),
    "file": (".rrd", ".csv", ".mkv", ".c3d", ".trc", ""),
    "names": (".toml",),
    "calibrate": (".json",),
    "avatar": (".vrm",),
    "k4abt": (".so",),
    "source": (".csv",),
}


def inputs_of(command):
    """The options of a command that name an input."""
    kinds = {name: get_args(kind) or (kind,) for name, kind in kinds_of(command).items()}
    return [name for name, of in kinds.items() if (Path in of or name in ALSO_FILES) and name not in OUTPUTS]


INPUTS = [
    (command, name, ending)
    for command in COMMANDS
    if command not in ("doctor", "tracker fetch")  # a report of what is there, and an output
    for name in inputs_of(command)
    for ending in ENDINGS.get(name, (".json",))
]
MORE = {"avatar": ["--vmc", "127.0.0.1:9", "--no-viewer"], "tracker_model": ["--tracker", "blazepose"]}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    write_pair(folder)
    simulated_session(seconds=1.0).save(folder / "s.rrd")
    for name in ("a.mkv", "b.mkv", "mocap.trc"):
        (folder / name).write_bytes(b"\x1aE\xdf\xa3")
    return folder


def line_of(command, name, bad, good, out):
    """A command line in which all inputs are there but one."""
    images = "skeletons" in name or command == "live"
    first = good / ("a.csv" if command == "info" and name == "names" else "s.rrd")
    there = {side: good / f"{side}.{'mkv' if images else 'csv'}" for side in "ab"}
    there |= {"session": first, "file": first, "first": first, "source": good, "folder": out, "out": out}
    there |= {
        "publish": "a",
        "recording": good / "a.mkv",
        "second": good / "mocap.trc",
        "save": out / "n.rrd",
        "to": out / "n.csv",
        name: bad,
    }
    stated = {*needed(command), name} | ({"a", "b"} if name in ("a", "b") else set())
    stated |= {"recording"} if command == "sensor" else set()
    more = MORE.get(name, [])
    return [*words_of(command, {each: there.get(each, "x") for each in stated}), *more]


FAULTS = ["fifo", "device", "folder", "missing", "binary", "unreadable", "huge"]
"""A huge file has holes: it takes no room on the disk, and no memory holds it."""


def put_there(folder):
    """Puts files where outputs go; what they hold."""
    for name in ("n.rrd", "n.csv", "n.json", "n.html", "n.zip", "n.mcap"):
        (folder / name).write_text("old")
    return contents(folder)


def contents(folder):
    return {
        path.relative_to(folder): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 20
    }


@pytest.mark.parametrize("kind", FAULTS)
@pytest.mark.parametrize(("command", "name", "ending"), INPUTS)
def test_every_input(command, name, ending, kind, good, tmp_path, capsys):
    if kind == "folder" and name in ("source", "tracker_model"):
        pytest.skip("it is a folder")
    bad = tmp_path / f"bad{ending}"
    if kind == "fifo":
        os.mkfifo(bad)
    elif kind == "device":
        bad.symlink_to("/dev/zero")
    elif kind == "folder":
        bad.mkdir()
    elif kind == "binary":
        bad.write_bytes(bytes(range(255, 0, -1)) * 16)
    elif kind == "unreadable":
        if not Path("/proc/self/mem").exists():
            pytest.skip("no file is known here that gives an error when it is read")
        bad.symlink_to("/proc/self/mem")
    elif kind == "huge":
        with bad.open("wb") as file:
            file.truncate(20 << 30)

    def waits(*_):
        raise AssertionError(f"{command} waits for {name}")

    there, force = put_there(tmp_path), ["--force"] if "force" in kinds_of(command) else []

    before = signal.signal(signal.SIGALRM, waits)
    signal.alarm(30)
    try:
        assert duplex(*line_of(command, name, bad, good, tmp_path), *force) == 2
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    one_line(capsys)
    assert contents(tmp_path) == there


FILES = {
    "save": "n.rrd",
    "report": "n.json",
    "save_calibration": "n.json",
    "html": "n.html",
    "to": "n.csv",
    "bundle": "n.zip",
    "save_mcap": "n.mcap",
}
TAKEN = [(command, name) for command in COMMANDS for name in FILES if name in kinds_of(command)]


@pytest.mark.parametrize(("command", "name"), TAKEN)
def test_what_is_there_stays_without_force(command, name, good, tmp_path, capsys):
    there = put_there(tmp_path)
    line = line_of(command, name, tmp_path / FILES[name], good, tmp_path / "more")
    assert duplex(*line, *(["--no-viewer"] if "no_viewer" in kinds_of(command) else [])) == 2
    assert FILES[name] in one_line(capsys)
    assert contents(tmp_path) == there


@pytest.mark.parametrize("text", ["[" * 5000, "joints = " + "[" * 5000, f"joints = {'1' * 5000}", "\ufeff"])
def test_tables_of_names_that_no_parser_takes(text, good, tmp_path, capsys):
    table = tmp_path / "names.toml"
    table.write_text(text)
    assert duplex("info", good / "a.csv", "--names", table) == 2
    assert "names.toml" in one_line(capsys)


@pytest.mark.skipif(sys.platform != "linux", reason="names are bytes")
def test_names_that_are_not_utf_8(tmp_path, capsys):
    odd = tmp_path / os.fsdecode(b"\xff")
    write_pair(odd)
    out = "--out", tmp_path / "o"
    for line in (("info", odd / "a.csv"), ("batch", odd, *out), ("batch", tmp_path, *out)):
        assert duplex(*line) == 2
        assert r"\udcff" in one_line(capsys)


def test_a_user_without_a_home_has_a_cache(monkeypatch):
    def nobody():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", nobody)
    for variable in ("XDG_CACHE_HOME", "LOCALAPPDATA", "HOME"):
        monkeypatch.delenv(variable, raising=False)
    assert user_cache("blazepose").is_absolute()
    assert duplex("info", "none.rrd") == 2
    Anonymity([])
