"""A process that writes many files keeps no threads of their streams, and the layout is whole."""

import numpy as np
import psutil
import rerun as rr
import rerun.blueprint as rrb

from recordings.file.session_writer import whole_recording
from tests.helpers.waiting import eventually

LAYOUT = rrb.Blueprint(
    rrb.Horizontal(rrb.Spatial3DView(origin="/points", name="scene"), rrb.TextLogView(origin="/log")),
    rrb.TimePanel(state="collapsed"),
)


def write(path):
    with whole_recording(path, LAYOUT) as stream:
        stream.set_time("frame", sequence=0)
        stream.log("points", rr.Points3D(np.zeros((5, 3))))


def test_no_threads_of_earlier_files_remain(tmp_path):
    process = psutil.Process()
    write(tmp_path / "0.rrd")
    write(tmp_path / "1.rrd")
    threads = process.num_threads()
    for k in range(2, 8):
        write(tmp_path / f"{k}.rrd")
    assert eventually(lambda: process.num_threads() <= threads)
