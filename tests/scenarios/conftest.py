"""The option of the scenarios."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--figures",
        action="store_true",
        help="test how fast the scenarios run, too; needs a machine that does nothing else, and -n 0",
    )
