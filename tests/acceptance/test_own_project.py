"""A project of a user's own: a fresh folder with a test, and ``pytest`` in it; nothing is configured."""

import re

from tests.acceptance.conftest import copied
from tests.helpers.documents import ROOT, python_of
from tests.helpers.programs import typed

_VERIFYING, _PRINTED = (block for block in python_of(ROOT / "docs" / "testing.md") if "def test_" in block)


def test_a_users_tests_are_given_their_sessions_and_pass(walk, tmp_path, home):
    """As the page prints them; ``tests/recordings/test_pytest_plugin.py`` has those that fail."""
    copied(walk.with_name("kinect_v2_90deg_stationary"), tmp_path)
    (tmp_path / "test_fusion.py").write_text(_PRINTED, encoding="utf-8")
    said = []
    for line in ("pytest --duplex-update", "pytest"):
        with typed(line, tmp_path, **home) as run:
            said.append((run.code(), run.said))
    assert [code for code, _ in said] == [0, 0], said
    assert "Wrote expected.rrd." in said[0][1]
    assert "2 passed" in said[1][1]


def test_five_lines_verify_a_session(walk, tmp_path, home):
    """A usable session passes; of a poor one the reasons, the seconds and the command are said."""
    copied(walk.with_name("kinect_v2_90deg_steps"), tmp_path)
    (tmp_path / "test_session.py").write_text(_VERIFYING, encoding="utf-8")
    fused = "duplex fuse a.csv b.csv --no-viewer --save walk.rrd"
    said = []
    for line in (fused, "pytest", f"{fused} --force --offset 400", "pytest"):
        with typed(line, tmp_path, **home) as run:
            said.append((run.code(), run.said))
    codes = [code for code, _ in said]
    assert codes == [0, 0, 0, 1], said
    failed = said[-1][1]
    assert "walk.rrd is poor; asked for was usable." in failed
    assert re.search(r"\d s poor: B captures -4\d\d ± \d+ ms off its time stamps", failed)
    assert "actual is walk.rrd" in failed
    assert re.search(r"to see it:    duplex review \S+actual\.rrd", failed)
