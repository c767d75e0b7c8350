"""Output files are whole or absent, have one writer, and leave nothing behind."""

import subprocess
import sys

import pytest

from devices.output_file import GrowingOutput, Hidden, TakenError, free_name, whole_file

KILLED = """
import os, sys
from pathlib import Path
from devices.output_file import GrowingOutput, Hidden
path = Path(sys.argv[1])
growing, folder = GrowingOutput(path, overwrite=True), Hidden(path, folder=True)
(folder.path / "a.log").write_text("x")
growing.append(b"half")
print("written", flush=True)
sys.stdin.read()
os._exit(9)
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_that_is_there_is_left_alone(tmp_path):
    path = tmp_path / "s.rrd"
    path.write_text("theirs")  # made while we worked: nobody looked before
    with pytest.raises(TakenError) as taken, whole_file(path, overwrite=False) as hidden:
        hidden.write_text("ours")
    assert (path.read_text(), taken.value.kept.read_text()) == ("theirs", "ours")
    assert names(tmp_path) == ["s-2.rrd", "s.rrd"]


def test_a_file_is_replaced_when_all_went_well(tmp_path):
    path = tmp_path / "s.rrd"
    path.write_text("before")

    def fail_half_way():
        with whole_file(path, overwrite=True) as hidden:
            hidden.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert path.read_text() == "before"
    with whole_file(path, overwrite=True) as hidden:
        hidden.write_text("after")
        with whole_file(hidden, overwrite=True) as same:
            assert same == hidden
    assert (path.read_text(), names(tmp_path)) == ("after", ["s.rrd"])


def test_remains_of_a_killed_process_are_removed_and_not_those_of_a_living_one(tmp_path):
    (tmp_path / "s.mkv").write_text("before")
    command = [sys.executable, "-c", KILLED, str(tmp_path / "s.mkv")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"written\n"
        living = names(tmp_path)
        with whole_file(tmp_path / "t.rrd", overwrite=False) as hidden:
            hidden.write_text("t")
        assert names(tmp_path) == sorted([*living, "t.rrd"])
        assert len(living) == 3
        process.kill()
    assert (tmp_path / "s.mkv").read_text() == "before"
    with whole_file(tmp_path / "u.rrd", overwrite=False) as hidden:
        hidden.write_text("u")
    assert names(tmp_path) == ["s.mkv", "t.rrd", "u.rrd"]


def test_a_shared_lock_is_held_by_one(tmp_path):
    path = tmp_path / "s.rrd"
    first = Hidden(path, shared=True)
    with pytest.raises(BlockingIOError):
        Hidden(path, shared=True)
    first.remove()
    Hidden(path, shared=True).remove()
    assert names(tmp_path) == []


def test_an_older_file_stays_until_a_growing_one_is_safe(tmp_path, monkeypatch):
    now = [0.0]
    monkeypatch.setattr("devices.output_file.time.monotonic", lambda: now[0])
    path = tmp_path / "s.mkv"
    path.write_bytes(b"before")
    file = GrowingOutput(path, overwrite=True)
    file.append(b"12")
    assert path.read_bytes() == b"before"
    now[0] = 1.0
    file.append(b"34")
    assert path.read_bytes() == b"1234"
    file.append(b"56")
    file.patch(0, b"x")
    file.close()
    assert (path.read_bytes(), names(tmp_path)) == (b"x23456", ["s.mkv"])
    for whole, content in ((False, b"x23456"), (True, b"78")):
        file = GrowingOutput(path, overwrite=True)
        file.append(b"78")
        file.close(whole=whole)
        assert (path.read_bytes(), names(tmp_path)) == (content, ["s.mkv"])


def test_a_growing_file_does_not_replace_an_older_one_unasked(tmp_path):
    path = tmp_path / "s.mkv"
    path.write_bytes(b"before")
    file = GrowingOutput(path, overwrite=False)
    with pytest.raises(FileExistsError):
        file.append(b"12")
    file.close()
    assert (path.read_bytes(), names(tmp_path)) == (b"before", ["s.mkv"])


def test_a_free_name_is_the_first_that_is_free(tmp_path):
    path = tmp_path / "demo.rrd"
    assert free_name(path) == path
    for taken in ("demo.rrd", "demo-2.rrd"):
        (tmp_path / taken).write_text("")
    assert free_name(path) == tmp_path / "demo-3.rrd"
