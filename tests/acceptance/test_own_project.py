"""A project of a user's own: a fresh folder with a test, and ``pytest`` in it; nothing is configured."""

import pytest

from tests.acceptance.conftest import copied
from tests.helpers.documents import ROOT, python_of
from tests.helpers.programs import typed

(_PRINTED,) = (block for block in python_of(ROOT / "docs" / "python.md") if "def test_" in block)
_EXAMPLE = (ROOT / "examples" / "test_fusion.py").read_text(encoding="utf-8")


@pytest.mark.parametrize("source", [_PRINTED, _EXAMPLE], ids=["as the page prints it", "the example"])
def test_a_users_tests_fail_once_are_given_their_sessions_and_pass(source, walk, tmp_path, home):
    copied(walk.with_name("kinect_v2_90deg_stationary"), tmp_path)
    (tmp_path / "test_fusion.py").write_text(source, encoding="utf-8")
    said = []
    for line in ("pytest", "pytest --duplex-update", "pytest"):
        with typed(line, tmp_path, **home) as run:
            said.append((run.code(), run.said))
    assert [code for code, _ in said] == [1, 0, 0], said
    assert "There is no session" in said[0][1] or "There is no" in said[0][1]
    assert "1 failed, 1 passed" in said[0][1]
    assert "Wrote expected.rrd." in said[1][1]
    assert "2 passed" in said[2][1]
