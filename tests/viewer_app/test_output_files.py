"""Output files are complete or absent, and never replace files of others."""

import pytest

from viewer_app.errors import UsageError
from viewer_app.output_files import free_name, whole_file


def test_a_file_that_came_meanwhile_is_left_alone(tmp_path):
    path = tmp_path / "s.rrd"

    def both_write():
        with whole_file(path) as partial:
            partial.write_text("ours")
            path.write_text("theirs")

    with pytest.raises(UsageError, match=r"another program meanwhile.*s-2\.rrd"):
        both_write()
    assert path.read_text() == "theirs"
    assert (tmp_path / "s-2.rrd").read_text() == "ours"
    assert len(list(tmp_path.iterdir())) == 2


def test_a_file_that_was_there_is_replaced_when_all_went_well(tmp_path):
    path = tmp_path / "s.rrd"
    path.write_text("before")

    def fail_half_way():
        with whole_file(path) as partial:
            partial.write_text("half")
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail_half_way()
    assert path.read_text() == "before"
    with whole_file(path) as partial:
        partial.write_text("after")
    assert [(file, file.read_text()) for file in tmp_path.iterdir()] == [(path, "after")]


def test_a_free_name_is_the_first_that_is_free(tmp_path):
    path = tmp_path / "demo.rrd"
    assert free_name(path) == path
    for taken in ("demo.rrd", "demo-2.rrd"):
        (tmp_path / taken).write_text("")
    assert free_name(path) == tmp_path / "demo-3.rrd"
