"""What the walk shares: a desk with a screen, the folder of a user, two simulated Azure Kinects."""

import os
import shutil
import time
from pathlib import Path

import pytest
from PIL import Image

from devices.cache import user_cache
from tests.helpers.rig import built_rig
from tests.helpers.screens import x_screen

PICTURES = os.environ.get("DUPLEX_PICTURES")
"""A folder to keep what the walk saw, to be looked at."""


@pytest.fixture(scope="session")
def desk():
    """A desk with a screen of X; its windows are closed after each step."""
    with x_screen() as screen:
        yield screen


@pytest.fixture
def seen(request):
    """Keeps a picture that the walk saw."""

    def keep(picture, of=""):
        if PICTURES and picture is not None:
            Path(PICTURES).mkdir(parents=True, exist_ok=True)
            Image.fromarray(picture).save(Path(PICTURES) / f"{request.node.name}{of}.png")

    return keep


@pytest.fixture(scope="session")
def home(tmp_path_factory):
    """The environment of a user with an empty home folder, who has the networks and compiled kernels."""
    folder = tmp_path_factory.mktemp("home")
    return {"HOME": str(folder), "XDG_CACHE_HOME": str(user_cache("").parent)}


@pytest.fixture(scope="session")
def walk(shared):
    """The recordings of a real walk."""
    return shared / "real" / "kinect_v2_90deg_walk"


class Sensors:
    """Two Azure Kinects on a sync cable before a person, on the real libk4a.

    Attributes:
        environment: The variables by which the program finds them.
        tracker: The options that name their body tracker.
    """

    def __init__(self, rig, folder):
        for file in (rig / "bus").iterdir():
            (folder / file.name).symlink_to(file)
        self._conf = folder / "rig.conf"
        self.environment = {
            "LD_LIBRARY_PATH": str(rig / "lib"),
            "PYTHONPATH": str(rig / "site"),
            "RIG_DIR": str(folder),
        }
        self.tracker = f"--k4abt {rig / 'lib' / 'libk4abt.so.1.1'}"
        self.person_begins()

    def person_begins(self):
        """The person stands in the start-up pose for some seconds from now on, and then walks."""
        unfinished = self._conf.with_suffix(".new")
        unfinished.write_text(f"a.jack=2\nb.jack=1\nt0={time.monotonic()}\n", encoding="utf-8")
        unfinished.rename(self._conf)


@pytest.fixture(scope="session")
def kinects(shared, tmp_path_factory):
    """Two Azure Kinects; the test is skipped where the rig or a compiler is missing."""
    return Sensors(built_rig(shared), tmp_path_factory.mktemp("rig"))


def copied(recordings, folder):
    """A folder with ``a.csv`` and ``b.csv``."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("a.csv", "b.csv"):
        shutil.copy(recordings / name, folder)
    return folder
