"""Fixtures of all tests: the reference recordings, and stand-ins for the sensors' libraries."""

import os
import signal
import threading
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, settings

from tests.helpers import scripted_sensor

# A deadline measures the machine, and the first example of a test may compile a kernel.
settings.register_profile(
    "duplex",
    deadline=None,
    derandomize=True,
    max_examples=25,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
settings.load_profile("duplex")
# for one long run of laws without a number of their own: pytest --hypothesis-profile many FILE
settings.register_profile(
    "many",
    derandomize=False,
    max_examples=2000,
    stateful_step_count=10,
    phases=[Phase.generate],
    print_blob=True,
)

# A shell without job control starts background jobs with SIGINT ignored, and child processes inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = (
    "tests.helpers.compiled_kernels",
    "tests.helpers.fused_runs",
    "tests.helpers.machine",
    "tests.helpers.standin_library",
    "tests.helpers.standin_pyk4a",
    "tests.helpers.real_libraries",
    "tests.helpers.real_people",
    "tests.helpers.orbbec.standin",
    "tests.helpers.freenect",
    "tests.helpers.freenect2.standin",
    "tests.helpers.realsense",
    "tests.helpers.vendors",
)


@pytest.fixture(autouse=True)
def _earlier_threads():
    scripted_sensor.earlier_threads = set(threading.enumerate())


@pytest.fixture(scope="session")
def shared():
    """The folder of reference recordings beside the project."""
    root = Path(__file__).resolve().parent.parent
    folder = Path(os.environ.get("DUPLEX_SHARED", root.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no reference recordings at {folder}; DUPLEX_SHARED may name another place")
    return folder
