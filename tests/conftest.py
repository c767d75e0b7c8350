"""Fixtures of all tests: the reference recordings, and stand-ins for the sensors' libraries."""

import os
import signal
import socket
import threading
from pathlib import Path
from uuid import uuid4

import pytest
from hypothesis import HealthCheck, settings

# A deadline measures the machine, and the first example of a test may compile a kernel.
_OF_ALL = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.function_scoped_fixture],
    "stateful_step_count": 25,
}
settings.register_profile("duplex", derandomize=True, max_examples=10, **_OF_ALL)
settings.load_profile("duplex")
# "make laws": other examples in each run
settings.register_profile("laws", max_examples=200, print_blob=True, **_OF_ALL)

# What a desk or a terminal sets: a test that wants it sets it, and nothing opens on a developer's screen.
_OF_A_DESK = (
    "DISPLAY WAYLAND_DISPLAY XAUTHORITY COLUMNS LINES NO_COLOR FORCE_COLOR TTY_COMPATIBLE TTY_INTERACTIVE"
)
for _name in _OF_A_DESK.split():
    os.environ.pop(_name, None)

# A shell without job control starts background jobs with SIGINT ignored, and child processes inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = (
    "tests.helpers.compiled_kernels",
    "tests.helpers.machine",
    "tests.helpers.standin_library",
    "tests.helpers.standin_pyk4a",
    "tests.helpers.real_libraries",
    "tests.helpers.orbbec.standin",
    "tests.helpers.freenect",
    "tests.helpers.freenect2.standin",
    "tests.helpers.realsense",
)


@pytest.fixture
def earlier_threads():
    """The threads that run before the test, this one among them; libraries that other tests use keep some."""
    return set(threading.enumerate())


@pytest.fixture
def closed_port():
    """A TCP port of this machine that refuses connections: it is bound, and nobody listens."""
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))
        yield bound.getsockname()[1]


@pytest.fixture
def closed_display(closed_port):
    """The name of an X display of which no server answers."""
    return f"127.0.0.1:{closed_port - 6000}"


@pytest.fixture
def fused_run(tmp_path):
    """A function like :func:`record_fused` without the path; each call records a new session."""
    from tests.helpers.fused_runs import record_fused

    return lambda *pairs_and_calibration, **more: record_fused(
        tmp_path / f"{uuid4()}.rrd", *pairs_and_calibration, **more
    )


@pytest.fixture(scope="session")
def shared():
    """The folder of reference recordings beside the project."""
    root = Path(__file__).resolve().parent.parent
    folder = Path(os.environ.get("DUPLEX_SHARED", root.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(f"no reference recordings at {folder}; DUPLEX_SHARED may name another place")
    return folder
