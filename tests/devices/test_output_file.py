"""Output files are whole or absent, have one writer, and leave nothing behind."""

import errno
import os
import subprocess
import sys
from contextlib import ExitStack, contextmanager, suppress
from io import FileIO
from itertools import product, repeat
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from devices import output_file
from devices.output_file import GrowingOutput, Hidden, KeptError, OutputError, free_name, whole_file
from fusion import DuplexError
from recordings import MissingFileError

posix = pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX files")
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
    with pytest.raises(KeptError) as taken, whole_file(path, overwrite=False) as hidden:
        hidden.write_text("ours")
    assert (path.read_text(), taken.value.kept.read_text()) == ("theirs", "ours")
    assert names(tmp_path) == ["s-2.rrd", "s.rrd"]


def test_an_error_names_the_file_that_was_asked_for_and_is_of_the_program(tmp_path):
    wanted, full = tmp_path / "s.rrd", OSError(errno.ENOSPC, "No space left on device", "hidden")
    with (
        pytest.raises(OutputError) as told,
        whole_file(wanted, overwrite=True) as hidden,
        whole_file(hidden, overwrite=True),
    ):
        raise full
    assert str(told.value) == f"{wanted} could not be written: No space left on device."
    assert isinstance(told.value, OSError)
    for place, why in (
        (tmp_path, "it is not a regular file"),
        (tmp_path / "none" / "s.rrd", "No such file or"),
    ):
        with pytest.raises(DuplexError, match=why), whole_file(place, overwrite=True):
            pass
    with pytest.raises(MissingFileError, match="No file a"), whole_file(wanted, overwrite=True):
        raise MissingFileError("No file a.rrd.")
    assert names(tmp_path) == []


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
    file = GrowingOutput(path, overwrite=True)
    file.append(b"78")
    file.close()
    assert (path.read_bytes(), names(tmp_path)) == (b"78", ["s.mkv"])
    file = GrowingOutput(path, overwrite=True)
    file.append(b"9")
    with pytest.raises(KeptError, match=r"what was written is .*s-2\.mkv"):
        file.close(whole=False)
    file.close()
    assert (path.read_bytes(), (tmp_path / "s-2.mkv").read_bytes()) == (b"78", b"9")
    assert names(tmp_path) == ["s-2.mkv", "s.mkv"]


@pytest.mark.parametrize("there", ["file", "folder", "folder at first"])
def test_a_growing_file_is_kept_under_a_name_that_is_free(tmp_path, there):
    path = tmp_path / "s.mkv"
    path.write_bytes(b"before") if there == "file" else path.mkdir()
    file = GrowingOutput(path, overwrite=False)
    file.append(b"12")
    if there == "folder at first":
        path.rmdir()
    file.append(b"34")
    if there == "folder at first":
        file.close()
        assert (path.read_bytes(), names(tmp_path)) == (b"1234", ["s.mkv"])
        return
    with pytest.raises(KeptError) as error:
        file.close()
    kept = tmp_path / "s-2.mkv"
    assert (error.value.kept, names(tmp_path)) == (kept, ["s-2.mkv", "s.mkv"])
    assert str(kept) in error.value.strerror
    assert (kept.read_bytes(), path.is_dir() or path.read_bytes()) == (
        b"1234",
        there == "folder" or b"before",
    )


class Faulty:
    """The calls by which a file is written, of which some fail, in order; a failing write gives a part."""

    def __init__(self, faults):
        self.faults = iter(faults)

    def of(self, call):
        def faulty(*arguments, **how):
            self.fail()
            return call(*arguments, **how)

        return faulty

    def fail(self):
        number = next(self.faults, None)
        if number is not None:
            raise OSError(number, os.strerror(number))

    @contextmanager
    def calls(self):
        class File(FileIO):
            def write(of_file, block):  # noqa: N805
                part = max(len(block) // 2, 1)
                super().write(block[:part])
                self.fail()
                return part

        where = [
            (os, "open"),
            (os, "fsync"),
            (os, "link"),
            (Path, "replace"),
            (Path, "rename"),
            (Path, "chmod"),
        ]
        with ExitStack() as stack:
            stack.enter_context(patch.object(output_file, "FileIO", File))
            for owner, name in where:
                stack.enter_context(patch.object(owner, name, self.of(getattr(owner, name))))
            yield


faults = st.none() | st.sampled_from(
    [errno.EMFILE, errno.ENFILE, errno.ENOSPC, errno.EIO, errno.EROFS, errno.EINTR]
)
blocks = st.tuples(st.binary(min_size=1, max_size=9), st.binary(max_size=3))


@posix  # Windows opens the file again
@given(
    st.lists(blocks, min_size=1, max_size=6),
    st.lists(faults, max_size=40),
    st.lists(faults, max_size=20),
    st.booleans(),
    st.integers(0, 30),
)
def test_what_fails_is_tried_again_and_costs_nothing_that_is_written(blocks, faults, at_end, older, patience):
    """The file, or that of the error, has all blocks, or those before the first that was given up."""
    told = []

    def again(fault):
        told.append(fault.errno)
        return len(told) <= patience

    written, ending, stopped = b"", b"", False
    with TemporaryDirectory() as folder, patch.object(output_file, "_SAFE_S", 0.0):
        path = Path(folder) / "s.rrd"
        if older:
            path.write_bytes(b"before")
        file = GrowingOutput(path, overwrite=older, again=again)
        with Faulty(faults).calls(), suppress(OSError):
            for block, end in blocks:
                stopped = True
                file.append(block, end)
                written, ending, stopped = written + block, end, False
        assert stopped == (len(told) > patience)
        where = path
        with Faulty(at_end).calls():
            try:
                file.close()
            except KeptError as error:
                assert written
                where = error.kept
        kept = {path: b"before"} if older else {}
        if written:
            kept[where] = written + ending
        assert {each: each.read_bytes() for each in Path(folder).iterdir()} == kept


@posix
@pytest.mark.parametrize(("shared", "there"), list(product([True, False], repeat=2)))
def test_a_planted_link_is_not_followed(tmp_path, shared, there):
    target, path = tmp_path / "target", tmp_path / "out" / "s.rrd"
    path.parent.mkdir()
    if there:
        target.write_text("theirs")
    with patch.object(output_file, "_numbers", repeat(7)):
        first = Hidden(path, shared=shared)
        first.remove()
        first.path.symlink_to(target)
        with pytest.raises(OSError, match="is a link; remove it"):
            Hidden(path, shared=shared)
    assert target.exists() == there
    assert not there or target.read_text() == "theirs"


@posix
@pytest.mark.parametrize("stranger", [True, False])
@pytest.mark.parametrize("way", ["the output", "its folder"])
def test_a_link_to_an_output_is_followed_unless_a_stranger_made_it_where_all_may(tmp_path, stranger, way):
    if stranger and os.getuid():
        pytest.skip("only root can give a link to another user")
    shared, own = tmp_path / "shared", tmp_path / "own"
    shared.mkdir()
    own.mkdir()
    shared.chmod(0o1777)
    link = shared / ("s.csv" if way == "the output" else "folder")
    link.symlink_to(own / "s.csv" if way == "the output" else own)
    path = link if way == "the output" else link / "s.csv"
    if stranger:
        os.lchown(link, 65534, 65534)
        with (
            pytest.raises(OSError, match=f"{link.name} is a link of another user"),
            whole_file(path, overwrite=True),
        ):
            pass
    else:
        with whole_file(path, overwrite=False) as hidden:
            hidden.write_text("mine")
    assert names(own) == ([] if stranger else ["s.csv"])


@posix
def test_a_umask_that_hides_files_from_their_owner_hides_no_output(tmp_path):
    before = os.umask(0o777)
    try:
        with whole_file(tmp_path / "s.csv", overwrite=False) as hidden:
            assert hidden.stat().st_mode & 0o777 == 0o600
        Hidden(tmp_path / "s.zip", folder=True).remove()
    finally:
        os.umask(before)


def test_a_free_name_is_the_first_that_is_free(tmp_path):
    path = tmp_path / "demo.rrd"
    assert free_name(path) == path
    for taken in ("demo.rrd", "demo-2.rrd"):
        (tmp_path / taken).write_text("")
    assert free_name(path) == tmp_path / "demo-3.rrd"
