"""The page of accuracy and speed is what the benchmarks' files give, and short."""

from __future__ import annotations

from tests.benchmarks import results
from tests.benchmarks.page import PAGE, page


def test_the_page_has_the_figures_of_the_files() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(), "make benchmarks"


def test_the_page_is_short() -> None:
    words = [word for word in page().split() if any(map(str.isalnum, word))]
    assert len(words) <= 1300


def test_every_file_names_its_command_and_its_machine() -> None:
    for file in results.FOLDER.glob("*.json"):
        document = results.read(file.stem)
        assert document["command"].startswith("python -m tests.benchmarks."), file
        assert document["machine"]["processors"] >= 1
        assert document["figures"]
