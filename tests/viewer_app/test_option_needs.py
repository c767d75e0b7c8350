"""No option is without effect and without a word."""

import pytest

from viewer_app.errors import UsageError
from viewer_app.options.command_line import parsed

FUSE = ("fuse", "a.csv", "b.csv")
IMAGES = ("fuse", "a.mkv", "b.mkv")
BATCH = ("batch", "folder", "--out", "out")
SENSOR = ("sensor", "--publish", "lab/a")
SIMULATED = (*SENSOR, "--simulate", "a")
RECORDED = (*SENSOR, "--recording", "a.csv")

SAVED = (*IMAGES, "--skeletons-a", "a.csv", "--skeletons-b", "b.csv")
REMOTE = ("live", "--kinect-a", "zenoh:a", "--kinect-b", "zenoh:b")

NEEDED = [
    ((*FUSE, "--method", "paper"), "--smoothing 0.9", FUSE),
    ((*FUSE, "--method", "paper"), "--no-refine", FUSE),
    ((*FUSE, "--method", "published"), "--smooth whole", FUSE),
    (FUSE, "--weights equal", (*FUSE, "--method", "paper")),
    (FUSE, "--h 0.9", (*FUSE, "--method", "paper")),
    (FUSE, "--tracker k4abt", IMAGES),
    (FUSE, "--tracker-network lite", IMAGES),
    (FUSE, "--processing cpu", IMAGES),
    (FUSE, "--person left", IMAGES),
    (FUSE, "--depth none", IMAGES),
    ((*BATCH, "--scheduler", "tcp://pc:8786"), "--processes 7", BATCH),
    (SIMULATED, "--tracker k4abt", SENSOR),
    (SIMULATED, "--unit cm", RECORDED),
    (SIMULATED, "--depth", SENSOR),
    (SIMULATED, "--depth-mode WFOV_2X2BINNED", SENSOR),
    (SIMULATED, "--fps 5", SENSOR),
    (RECORDED, "--motion squat", SIMULATED),
    (RECORDED, "--body kinect_v1", SIMULATED),
    (RECORDED, "--tracker-network lite", (*SENSOR, "--recording", "a.mkv")),
    (SAVED, "--tracker k4abt", SAVED[:-2]),
    (SAVED, "--processing cpu", SAVED[:-2]),
    (REMOTE, "--fps 15", REMOTE[:-2]),
    (REMOTE, "--depth-mode WFOV_2X2BINNED", REMOTE[:-2]),
    (REMOTE, "--tracker k4abt", REMOTE[:-2]),
    (("live",), "--compress", ("live", "--record", "folder")),
    (("live", "a.mkv", "b.mkv"), "--fps 15", ("live",)),
    (("demo",), "--tracker-network lite", ("demo", "--tracker", "blazepose")),
    (("demo",), "--avatar a.vrm", ("demo", "--vmc", "39539")),
    (("demo", "--quiet"), "--verbose", ("demo",)),
]


@pytest.mark.parametrize(("line", "option", "enough"), NEEDED)
def test_an_option_that_would_have_no_effect_is_refused(line, option, enough):
    name, *_ = option.split()
    with pytest.raises(UsageError, match=f"^{name} needs "):
        parsed([*line, *option.split()])
    parsed([*enough, *option.split()])
    parsed(list(line))
