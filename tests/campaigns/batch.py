"""``duplex batch`` over many recordings: memory of the workers, and time with one and with two processes.

``python -m tests.campaigns.batch --recordings 200`` copies real pairs of the reference recordings and fuses
them twice. It prints both times and the growth of memory, and exits with code 1 if memory grows.
"""

from __future__ import annotations

import argparse
import os
import shutil
import sys
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import psutil

from viewer_app.batch.finding import find_pairs
from viewer_app.batch.jobs import Job
from viewer_app.batch.processes import run_in_processes
from viewer_app.options.batch import BatchOptions

GROWTH_MB = 40.0
"""Limit of the growth of all workers together, from the median over the second quarter of the recordings to
that over the last. With 200 recordings 100 lie between; Rerun's streams, if none were freed, keep about 4 MB
each, 400 MB in total."""


def measure(folder: Path, out: Path, processes: int) -> tuple[float, float, float]:
    """Fuses all pairs; returns wall and processor time in seconds, and the growth of all workers in MB."""
    options = BatchOptions(source=folder, out=out)
    pairs, _ = find_pairs(folder, out)
    me, memory, cpu = psutil.Process(), [], {}
    started = time.perf_counter()
    for outcome in run_in_processes([Job(pair, options) for pair in pairs], processes):
        assert not outcome.error, outcome
        workers = [child for child in me.children() if "spawn_main" in " ".join(child.cmdline())]
        memory.append(sum(worker.memory_info().rss for worker in workers) * 1e-6)
        cpu |= {worker.pid: sum(worker.cpu_times()[:2]) for worker in workers}
    wall = time.perf_counter() - started
    quarter = len(memory) // 4
    growth = np.median(memory[-quarter:]) - np.median(memory[quarter : 2 * quarter])
    print(
        f"{processes} processes, {len(pairs)} recordings: {wall:.1f} s, processor {sum(cpu.values()):.1f} s, "
        f"all workers' memory at most {max(memory):.0f} MB, growth {growth:.1f} MB, "
        f"{growth / (len(memory) - quarter - quarter):.2f} MB per recording",
        flush=True,
    )
    return wall, sum(cpu.values()), float(growth)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--recordings", type=int, default=200)
    parser.add_argument("--processes", type=int, nargs="+", default=[1, 2])
    arguments = parser.parse_args()
    shared = Path(os.environ.get("DUPLEX_SHARED", Path(__file__).resolve().parents[3] / "shared"))
    sources = [path for name in ("real", "real_more") for path in sorted((shared / name).iterdir())]
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "pairs"
        for k, source in enumerate(islice(cycle(sources), arguments.recordings)):
            shutil.copytree(source, folder / f"{k:03d}")
        figures = []
        for processes in arguments.processes:
            out = Path(place) / f"out{processes}"
            out.mkdir()
            figures.append(measure(folder, out, processes))
    if len(figures) > 1:
        print(
            f"{figures[0][0] / figures[-1][0]:.2f} × as fast; "
            f"processor time {figures[-1][1] / figures[0][1]:.2f} ×"
        )
    return int(any(growth > GROWTH_MB for _, _, growth in figures))


if __name__ == "__main__":
    sys.exit(main())
