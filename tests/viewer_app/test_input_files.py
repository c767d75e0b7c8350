"""What an option names as a file is refused in one line where it is none."""

import os
import signal
import sys
from dataclasses import MISSING, fields
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest

from devices.cache import user_cache
from recordings.testing import simulated_session
from tests.helpers.command_line import duplex, one_line
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


def inputs_of(options: Any) -> list[str]:
    """The options of a command that name an input."""
    hints = get_type_hints(options, include_extras=True)
    found = []
    for field in fields(options):
        hint = hints[field.name]
        kind: Any = get_args(hint)[0] if get_origin(hint) is Annotated else hint
        kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
        if (Path in kinds or field.name in ALSO_FILES) and field.name not in OUTPUTS:
            found.append(field.name)
    return found


INPUTS = [
    (command, name, ending)
    for command, (options, _) in COMMANDS.items()
    if command not in ("doctor", "tracker fetch")  # a report of what is there, and an output
    for name in inputs_of(options)
    for ending in ENDINGS.get(name, (".json",))
]
MORE = {"avatar": ["--vmc", "127.0.0.1:9", "--no-viewer"], "tracker_model": ["--tracker", "blazepose"]}
FLAGS = {"start": "from", "end": "to"}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    write_pair(folder)
    simulated_session(seconds=1.0).save(folder / "s.rrd")
    for name in ("a.mkv", "b.mkv", "mocap.trc"):
        (folder / name).write_bytes(b"\x1aE\xdf\xa3")
    return folder


def line_of(command: str, name: str, bad: Path, good: Path, out: Path) -> list[str]:
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
    line = [*command.split(), *MORE.get(name, ())]
    for field in fields(COMMANDS[command][0]):  # type: ignore[arg-type]
        needed = field.default is MISSING and field.default_factory is MISSING
        needed |= (command, field.name) == ("sensor", "recording")
        if needed or field.name == name or (field.name in ("a", "b") and name in ("a", "b")):
            value = str(there.get(field.name, "x"))
            flag = f"--{FLAGS.get(field.name, field.name).replace('_', '-')}"
            line += [value] if not field.kw_only else [flag, value]
    return line


FAULTS = ["fifo", "device", "folder", "missing", "binary", "unreadable", "huge"]
"""A huge file has holes: it takes no room on the disk, and no memory holds it."""


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

    before = signal.signal(signal.SIGALRM, waits)
    signal.alarm(30)
    try:
        assert duplex(*line_of(command, name, bad, good, tmp_path)) == 2
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    one_line(capsys)


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
