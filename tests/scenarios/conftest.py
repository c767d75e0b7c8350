"""The option of the scenarios, and what they run on."""

import pytest

from tests.helpers.rig import built_rig


@pytest.fixture(params=[pytest.param(name, marks=getattr(pytest.mark, name)) for name in ("standin", "rig")])
def rig(request):
    """Where the rig is built; None for the stand-in."""
    return built_rig(request.getfixturevalue("shared")) if request.param == "rig" else None


def pytest_addoption(parser):
    parser.addoption(
        "--figures",
        action="store_true",
        help="test how fast the scenarios run, too; needs a machine that does nothing else, and -n 0",
    )
