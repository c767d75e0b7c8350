"""A process that writes many files keeps no threads of their streams, and the layout is whole."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import rerun as rr
import rerun.blueprint as rrb

from recordings import layout
from recordings.file.session_writer import whole_recording
from tests.helpers.waiting import eventually

LAYOUT = rrb.Blueprint(
    rrb.Horizontal(rrb.Spatial3DView(origin="/points", name="scene"), rrb.TextLogView(origin="/log")),
    rrb.TimePanel(state="collapsed"),
)


def write(path: Path) -> None:
    with whole_recording(path, LAYOUT) as stream:
        stream.set_time("frame", sequence=0)
        stream.log("points", rr.Points3D(np.zeros((5, 3))))


def printed(path: Path) -> list[str]:
    """Rerun's own list of what a file holds, without identifiers and times."""
    said = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", str(path)], capture_output=True, text=True, check=True
    )
    lines = [line for line in said.stdout.splitlines() if line.startswith(("Chunk", "Blueprint"))]
    return [re.sub(r"chunk_\w+|[0-9a-f]{8}[0-9a-f-]{20,}|[\d.]+ KiB", "", line) for line in lines]


def test_no_threads_of_earlier_files_remain(tmp_path: Path) -> None:
    process = psutil.Process()
    write(tmp_path / "0.rrd")
    write(tmp_path / "1.rrd")
    threads = process.num_threads()
    for k in range(2, 8):
        write(tmp_path / f"{k}.rrd")
    assert eventually(lambda: process.num_threads() <= threads)


def test_the_layout_is_as_rerun_sends_it_and_comes_last(tmp_path: Path) -> None:
    write(tmp_path / "ours.rrd")
    stream = rr.RecordingStream(layout.APPLICATION_ID, recording_id="plain")
    stream.set_sinks(rr.FileSink(str(tmp_path / "plain.rrd")))
    stream.set_time("frame", sequence=0)
    stream.log("points", rr.Points3D(np.zeros((5, 3))))
    stream.flush(timeout_sec=60.0)
    stream.send_blueprint(LAYOUT)
    stream.flush(timeout_sec=60.0)
    stream.disconnect()
    ours, plain = printed(tmp_path / "ours.rrd"), printed(tmp_path / "plain.rrd")
    assert any("TimePanelBlueprint" in line for line in ours)
    assert ours == plain
    assert "make_active: true, make_default: true" in ours[-1]
