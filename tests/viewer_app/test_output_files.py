"""What a command writes is not written by another process at the same time."""

import sys

import pytest

from devices.output_file import Hidden
from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import write_pair
from viewer_app.errors import UsageError
from viewer_app.output_files import check_outputs, outputs_of_one_run, write_text


def test_of_two_processes_on_one_output_the_second_is_refused(tmp_path):
    path = tmp_path / "s.json"
    others = Hidden(path, shared=True)  # a lock is of one opening, so this is like another process's
    with (
        pytest.raises(UsageError, match=r"s\.json is being written by another process"),
        outputs_of_one_run(),
    ):
        check_outputs([path], [], force=True)
    others.remove()
    with outputs_of_one_run():
        check_outputs([path], [], force=True)
        check_outputs([path], [], force=True)  # the same run may ask again
        with pytest.raises(BlockingIOError):
            Hidden(path, shared=True)
    assert list(tmp_path.iterdir()) == []


def test_what_was_made_meanwhile_is_told_in_one_line(tmp_path):
    path = tmp_path / "s.json"
    path.write_text("theirs")
    with pytest.raises(UsageError, match=r"another program meanwhile.*s-2\.json"):
        write_text(path, "ours", force=False)
    assert path.read_text() == "theirs"
    write_text(path, "ours", force=True)
    assert path.read_text() == "ours"


def test_of_two_batches_on_one_folder_the_second_is_refused(tmp_path, capsys):
    write_pair(tmp_path / "in")
    out = tmp_path / "out"
    out.mkdir()
    first = Hidden(out / "summary.parquet", shared=True)
    unfinished = out / ".partial" / "in.host-1"
    unfinished.mkdir(parents=True)
    assert duplex("batch", tmp_path / "in", "--out", out) == 2
    assert "is being written by another process" in one_line(capsys)
    assert unfinished.is_dir(), "the first one's work is left alone"
    first.remove()


def test_what_an_export_needs_is_looked_for_before_fusing(tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pygltflib", None)
    monkeypatch.setattr("viewer_app.commands.fuse._read", lambda *_: pytest.fail("it is read"))
    write_pair(tmp_path)
    outputs = "--save", tmp_path / "s.rrd", "--to", tmp_path / "t.glb"
    assert duplex("fuse", tmp_path / "a.csv", tmp_path / "b.csv", "--no-viewer", *outputs) == 2
    assert "Writing .glb needs the package pygltflib" in one_line(capsys)


def test_a_folder_that_the_system_refuses_is_told_in_one_line(tmp_path, capsys):
    for path in (tmp_path / ("a" * 300), tmp_path / ("a" * 300) / "b.rrd", tmp_path / "new" / ("a" * 300)):
        assert duplex("demo", "--no-viewer", "--record", path) == 2
        assert one_line(capsys) == f"duplex: The folder {path} cannot be created: File name too long.\n"
    assert list(tmp_path.iterdir()) == []


def test_a_run_that_records_nothing_leaves_no_folder(tmp_path, capsys, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("viewer_app.commands.demo.warm_up", stopped)
    there = tmp_path / "there"
    there.mkdir()
    for folder in (tmp_path / "above" / "new", there):
        assert duplex("demo", "--no-viewer", "--record", folder) == 130
        assert capsys.readouterr().err == "duplex: stopped\n"
    assert list(tmp_path.iterdir()) == [there]
