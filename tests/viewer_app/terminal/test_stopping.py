"""Ctrl-C while the program starts ends it with one line and exit code 130."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.helpers.documents import ROOT

PRESSED_DURING_IMPORT = """
import sys
from importlib.abc import MetaPathFinder

class CtrlC(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {name!r}:
            raise KeyboardInterrupt

sys.meta_path.insert(0, CtrlC())
sys.argv = ["duplex", "info", "none.rrd"]
from viewer_app.cli import script
script()
"""


@pytest.mark.parametrize("name", ["viewer_app.options.command_line", "cyclopts", "numpy", "rerun"])
def test_ctrl_c_during_the_imports(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PRESSED_DURING_IMPORT.format(name=name)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert (ended.returncode, ended.stderr) == (130, "duplex: stopped\n")
