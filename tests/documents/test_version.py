"""The version is the same wherever it is written."""

from __future__ import annotations

import re
import tomllib

from tests.helpers.documents import ROOT


def test_the_version_and_its_date_are_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [version]
    released = re.findall(r'^date-released: "(.*)"$', citation, re.MULTILINE)
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"^## (\d\S*) \((.*)\)$", changes, re.MULTILINE)
    assert newest is not None
    assert newest.groups() == (version, *released)
