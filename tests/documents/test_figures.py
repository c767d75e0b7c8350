"""Figures in the documents are those that the program prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.helpers.command_line import duplex
from tests.helpers.documents import ROOT


def test_the_summary_on_the_start_page_is_that_of_the_real_walk(
    shared: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    page = (ROOT / "docs" / "start.md").read_text(encoding="utf-8")
    shown = re.search(r"such as this one of a walk.*?```text\n(.*?)```", page, re.DOTALL)
    assert shown is not None
    folder = shared / "real" / "kinect_v2_90deg_walk"
    assert duplex("fuse", folder / "a.csv", folder / "b.csv", "--no-viewer") == 0
    printed = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    begin = next(k for k, line in enumerate(printed) if line.startswith("Verdict"))
    lines = shown[1].splitlines()
    assert printed[begin : begin + len(lines)] == lines
