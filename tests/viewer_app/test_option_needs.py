"""No option is without effect and without a word."""

from pathlib import Path

import pytest

from tests.helpers.command_line import duplex
from tests.helpers.recorded_pairs import write_pair
from viewer_app.errors import UsageError
from viewer_app.options.command_line import parsed
from viewer_app.options.needs import refuse_without_effect
from viewer_app.options.sensing import FuseOptions

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
    (FUSE, "--orientation 90,0", IMAGES),
    (SIMULATED, "--orientation 90", SENSOR),
    (RECORDED, "--orientation 90", SENSOR),
    (REMOTE, "--orientation 90", REMOTE[:-2]),
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
    ((*FUSE, "--calibrate", "c.json"), "--no-refine", (*FUSE, "--calibrate", "seconds:3")),
    ((*BATCH, "--calibrate", "c.json"), "--no-refine", BATCH),
    ((*FUSE, "--no-viewer"), "--layout angles", (*FUSE, "--no-viewer", "--save", "s.rrd")),
    (("live", "--no-viewer"), "--layout angles", ("live",)),
    ((*IMAGES, "--no-viewer"), "--depth half", (*IMAGES, "--no-viewer", "--save", "s.rrd")),
    (IMAGES, "--unit cm", FUSE),
    ((*SENSOR, "--recording", "a.mkv"), "--unit cm", RECORDED),
    ((*IMAGES, "--tracker", "k4abt"), "--person left", IMAGES),
    ((*IMAGES, "--tracker", "k4abt"), "--tracker-network lite", (*IMAGES, "--tracker", "blazepose")),
    (("live", "--k4abt", "x.so"), "--tracker-model folder", ("live",)),
    ((*SENSOR, "--tracker", "blazepose"), "--processing cpu", (*SENSOR, "--tracker", "k4abt")),
    (("doctor",), "--person left", ("live",)),
    (("demo", "--bad-setup"), "--layout angles", ("demo",)),
    (("demo", "--motion", "list"), "--seconds 3", ("demo", "--motion", "walk")),
    (("review", "s.rrd", "--no-viewer"), "--event 1", ("review", "s.rrd")),
    (("review", "s.rrd", "--no-viewer"), "--at 1", ("review", "s.rrd", "--web")),
]


@pytest.mark.parametrize(("line", "option", "enough"), NEEDED)
def test_an_option_that_would_have_no_effect_is_refused(line, option, enough):
    name, *_ = option.split()
    with pytest.raises(UsageError, match=f"^{name} (needs|cannot be used with) "):
        parsed([*line, *option.split()])
    parsed([*enough, *option.split()])
    parsed(list(line))


def test_a_batch_refuses_an_option_that_no_pair_has_a_use_for(tmp_path, capsys):
    given = {"tracker": "k4abt", "unit": "cm"}
    of_csv, of_mkv = (FuseOptions(a=Path(f"a.{end}"), b=Path(f"b.{end}"), **given) for end in ("csv", "mkv"))
    refuse_without_effect(of_csv, of_mkv)
    for alone, option in ((of_csv, "tracker"), (of_mkv, "unit")):
        with pytest.raises(UsageError, match=f"^--{option} needs "):
            refuse_without_effect(alone, alone)
    write_pair(tmp_path / "pairs")
    assert duplex("batch", tmp_path / "pairs", "--out", tmp_path / "out", "--tracker", "k4abt") == 2
    assert "--tracker needs a recording of images" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
