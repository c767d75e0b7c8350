"""``duplex bench speed``: measures the time per frame of the solvers and of the whole program."""

from __future__ import annotations

import json
import math
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from devices.pairing import pair_recordings
from devices.people import choose_person
from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import BODIES, KINECT_V2, Body
from fusion.setup import Method
from fusion.skeleton import Skeleton, SkeletonPair
from recordings.session import Session
from viewer_app.bench.solvers import Timing, exact, random_frames, time_solver, time_solvers
from viewer_app.bench.update_cost import (
    STAGES,
    UpdateTiming,
    repeated,
    simulated_pairs,
    start_up,
    time_growth,
    time_update,
    warm_frames,
)
from viewer_app.errors import UsageError
from viewer_app.options.bench import BenchSpeedOptions
from viewer_app.output_files import check_writable, whole_file

_METHODS: tuple[Method, ...] = ("duplex", "paper")
_COLD_FRAMES = 1000
_SECONDS = 20.0
_SHORT, _LONG = 600, 6600  # pairs of the two recordings whose difference separates writing from start-up
_WIDTH = 120  # columns if the output is not a terminal, so that no table is cut
_PAIRS_A_MINUTE = 1800  # at 30 fps


@dataclass(frozen=True)
class Writing:
    """Throughput of ``duplex fuse --save --no-viewer`` end to end, and of reading the session again.

    Attributes:
        pairs_per_s: Pairs per second after start-up.
        start_up_s: Start-up time, extrapolated to zero pairs.
        bytes_a_minute: Size of the session per minute at 30 fps.
        opened_per_s: Pairs per second when a session is opened.
        replayed_per_s: Pairs per second that ``duplex replay --verify`` reads, fuses and compares.
    """

    pairs_per_s: float
    start_up_s: float
    bytes_a_minute: float
    opened_per_s: float = math.nan
    replayed_per_s: float = math.nan


def run(options: BenchSpeedOptions) -> None:
    """Carries out the command.

    Raises:
        DeviceError, FusionError, UsageError: With one line for the person who asked.
    """
    console = _wide_enough(Console())
    if options.json is not None:
        _check_creatable(options.json, options.force)
    recordings = [_recorded(*options.recording)] if options.recording is not None else []
    written = recordings[0] if recordings else None
    for body in BODIES.values():
        with console.status(f"a simulated walk of {len(body)} joints"):
            pairs = [pair.skeletons for pair in simulated_pairs(body, _SECONDS)]
        recordings.append((f"{len(body)} joints, simulated", body, pairs))
        if written is None and body is KINECT_V2:
            written = recordings[-1]
    assert written is not None

    with console.status("cold frames, one solver after the other"):
        solvers = time_solvers(random_frames(_COLD_FRAMES))
    updates = []
    for name, body, pairs in recordings:
        calibration = start_up(pairs, body)
        frames = warm_frames(pairs, calibration)
        solvers.append(time_solver(f"exact, warm, {name}", exact(body), frames))
        updates += [time_update(name, pairs, calibration, method) for method in _METHODS]
    growth = time_growth((20, 32, 160))
    with console.status("duplex fuse, end to end"):
        writing = time_writing(*written[1:])
        help_s = time_help()

    if options.json is not None:
        figures = {
            "machine": f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}",
            "solvers": [asdict(timing) for timing in solvers],
            "updates": [asdict(timing) for timing in updates],
            "linear_system_us": {str(joints): of for joints, of in growth.items()},
            "writing": asdict(writing),
            "help_s": help_s,
        }
        with whole_file(options.json) as partial:
            partial.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    for table in (_solver_table(solvers), _update_table(updates), _program_table(growth, writing, help_s)):
        console.print(table)


def _check_creatable(path: Path, force: bool) -> None:
    """Checks that a file can be created before minutes of timing; permissions alone do not show this."""
    check_writable(path, force)
    try:
        tempfile.TemporaryFile(dir=path.resolve().parent).close()
    except OSError as error:
        raise UsageError(f"{path} cannot be written: {error.strerror or error}.") from error


def _recorded(path_a: Path, path_b: Path) -> tuple[str, Body, list[SkeletonPair]]:
    with SkeletonRecording(path_a) as a, SkeletonRecording(path_b) as b:
        if a.body is not b.body:
            raise DeviceError(f"{a.name} is of {a.body.name}, {b.name} of {b.body.name}.")
        frames_a, frames_b = list(a.frames()), list(b.frames())
        people = [
            choose_person(frames, None, name, f"--person-{side}")
            for frames, name, side in ((frames_a, a.name, "a"), (frames_b, b.name, "b"))
        ]
        pairs = pair_recordings(frames_a, frames_b, people[0], people[1]).pairs
        return f"{len(a.body)} joints, recorded", a.body, [pair.skeletons for pair in pairs]


def time_writing(body: Body, pairs: Sequence[SkeletonPair]) -> Writing:
    """Fuses a short and a long recording, each in a separate process, and uses the difference."""
    # noise, so that repeated frames do not compress better than a real recording
    rng = np.random.default_rng(0)
    many = [
        replace(pair, a=shaken(pair.a, rng), b=shaken(pair.b, rng))
        for pair in repeated(pairs, _LONG // len(pairs) + 1)
    ]
    seconds, sizes, replays = [], [], []
    with tempfile.TemporaryDirectory(prefix="duplex-bench-") as folder:
        session = Path(folder) / "session.rrd"
        for count in (10, _SHORT, _LONG):  # the first warms the kernels' and the system's caches
            files = [_write_csv(Path(folder) / f"{side}.csv", body, many[:count], side) for side in "ab"]
            command = ["fuse", *files, "--save", str(session), "--no-viewer", "--force", "--calibrate"]
            seconds.append(_seconds_of([*command, "seconds:3"]))
            sizes.append(session.stat().st_size)
            replays.append(_seconds_of(["replay", str(session), "--verify"]))
        before = time.perf_counter()
        Session.open(session)
        opened_per_s = _LONG / (time.perf_counter() - before)
    writing = writing_between((_SHORT, _LONG), seconds[1:], sizes[1:])
    replayed_per_s = (_LONG - _SHORT) / (replays[2] - replays[1])
    return replace(writing, opened_per_s=opened_per_s, replayed_per_s=replayed_per_s)


def shaken(skeleton: Skeleton | None, rng: np.random.Generator) -> Skeleton | None:
    """The skeleton with a millimetre of noise."""
    if skeleton is None:
        return None
    noise = rng.normal(0.0, 1e-3, skeleton.positions.shape)
    return replace(skeleton, positions=(skeleton.positions + noise).astype(np.float32))


def writing_between(pairs: Sequence[int], seconds: Sequence[float], sizes: Sequence[int]) -> Writing:
    """The cost per pair from the difference of a short and a long recording; the rest is start-up."""
    each = (seconds[1] - seconds[0]) / (pairs[1] - pairs[0])
    return Writing(
        pairs_per_s=1.0 / each,
        start_up_s=seconds[0] - pairs[0] * each,
        bytes_a_minute=(sizes[1] - sizes[0]) / (pairs[1] - pairs[0]) * _PAIRS_A_MINUTE,
    )


def _write_csv(path: Path, body: Body, pairs: Sequence[SkeletonPair], side: str) -> str:
    rows = ["time_us,body,joint,x,y,z,state"]
    for pair in pairs:
        skeleton: Skeleton | None = pair.a if side == "a" else pair.b
        if skeleton is not None:
            for name, at, state in zip(body.joints, skeleton.positions, skeleton.states, strict=True):
                if state:
                    rows.append(
                        f"{pair.time_ns // 1000},0,{name},{at[0]:.5f},{at[1]:.5f},{at[2]:.5f},{state}"
                    )
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return str(path)


def time_help() -> float:
    """Seconds that ``duplex --help`` takes: the best of five runs, to exclude a cold disk cache."""
    return min(_seconds_of(["--help"]) for _ in range(5))


def _seconds_of(arguments: Sequence[str]) -> float:
    before = time.perf_counter()
    subprocess.run([sys.executable, "-m", "viewer_app.cli", *arguments], check=True, capture_output=True)
    return time.perf_counter() - before


def _wide_enough(console: Console) -> Console:
    if not console.is_terminal:
        console.width = max(console.width, _WIDTH)
    return console


def _solver_table(solvers: Sequence[Timing]) -> Table:
    table = _table(
        "Eq. (1), per frame; cold: 20 joints, 10 mm noise",
        ("solver", "median", "p99", "max", "steps", "systems", "bones off", "joints off"),
        "Systems: linear ones, line search and abandoned starts included. Off: at worst, from their lengths, "
        "and from the lowest that exact, dense Newton and SLSQP find, where all three are run. "
        f"{_ratios(solvers)}",
    )
    for t in solvers:
        table.add_row(
            t.name, *map(_time, (t.median_us, t.p99_us, t.max_us)), f"{t.iterations:.0f}", f"{t.systems:.0f}",
            f"{t.bone_error_mm:.1g} mm", "–" if t.off_mm is None else f"{t.off_mm:.1g} mm",
        )  # fmt: skip
    return table


def _ratios(solvers: Sequence[Timing]) -> str:
    """The median of every other cold solver over that of the exact one."""
    exact_us = solvers[0].median_us
    others = [timing for timing in solvers[1:] if not timing.name.startswith("exact")]
    return "Exact is faster than " + "; ".join(f"{t.name}: {t.median_us / exact_us:,.0f}×" for t in others)


def _update_table(updates: Sequence[UpdateTiming]) -> Table:
    table = _table(
        "Fuser.update a pair, and the compiled stages of the method paper: processor time, µs",
        ("pairs", "method", "median", "p99", "p99.9", "max", *STAGES, "batch, pairs/s"),
    )
    for t in updates:
        whole = (t.median_us, t.p99_us, t.p999_us, t.max_us)
        stages = (f"{t.stages_us[stage]:.1f}" if t.stages_us else "–" for stage in STAGES)
        table.add_row(t.name, t.method, *(f"{us:.0f}" for us in whole), *stages, f"{t.batch_per_s:,.0f}")
    return table


def _program_table(growth: dict[int, float], writing: Writing, help_s: float) -> Table:
    table = Table(title="The program", title_justify="left", show_header=False, box=SIMPLE, pad_edge=False)
    sizes = " → ".join(map(str, growth))
    table.add_row(
        f"a linear system, {sizes} joints", " → ".join(f"{us:.1f}" for us in growth.values()) + " µs"
    )
    table.add_row("the same a joint", " → ".join(f"{us / j * 1e3:.0f}" for j, us in growth.items()) + " ns")
    table.add_row("duplex fuse --save --no-viewer", f"{writing.pairs_per_s:,.0f} pairs/s after start-up")
    table.add_row("its start-up", f"{writing.start_up_s:.1f} s")
    table.add_row("session file", f"{writing.bytes_a_minute / 1e6:.1f} MB a minute at 30 fps")
    table.add_row("opening an hour of it", f"{_PAIRS_A_MINUTE * 60 / writing.opened_per_s:.0f} s")
    table.add_row("duplex replay --verify", f"{writing.replayed_per_s:,.0f} pairs/s after start-up")
    table.add_row("duplex --help", f"{help_s:.2f} s")
    return table


def _table(title: str, columns: Sequence[str], caption: str | None = None) -> Table:
    table = Table(
        title=title,
        caption=caption,
        title_justify="left",
        caption_justify="left",
        box=SIMPLE,
        pad_edge=False,
        padding=(0, 1, 0, 0),
    )
    for k, column in enumerate(columns):
        table.add_column(column, justify="right" if k else "left", no_wrap=True)
    return table


def _time(microseconds: float) -> str:
    if microseconds < 1e3:
        return f"{microseconds:.1f} µs"
    return f"{microseconds * 1e-3:.1f} ms" if microseconds < 1e6 else f"{microseconds * 1e-6:.2f} s"
