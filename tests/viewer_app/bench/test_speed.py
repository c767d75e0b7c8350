"""``duplex bench speed``: it compares equal problems, and its result does not depend on the start."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from devices.sensor import DeviceError
from fusion.body import KINECT_V1, KINECT_V2, Body
from fusion.calibration.calibration import Calibration
from fusion.fuser import Fuser
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving, pair_of
from viewer_app import cli
from viewer_app.bench import solvers as bench_solvers
from viewer_app.bench import speed as bench_speed
from viewer_app.bench import update_cost as bench_update
from viewer_app.bench.solvers import Timing, random_frames, time_solvers
from viewer_app.bench.update_cost import UpdateTiming
from viewer_app.errors import UsageError
from viewer_app.options.bench import BenchSpeedOptions


def test_every_solver_solves_the_same_problem() -> None:
    by_name = {timing.name: timing for timing in time_solvers(random_frames(2))}
    exact, published = by_name["exact"], by_name["paper's scheme (numba)"]
    assert exact.bone_error_mm < 1e-9
    # 3e-11 m of force over pivots of at least a hundredth of the information is 3e-6 mm; the others likewise
    assert exact.off_mm is not None
    assert exact.off_mm < 1e-5
    assert published.bone_error_mm > 1e4 * exact.bone_error_mm
    assert published.excess < 0.0  # wrong bones buy a lower objective
    for name in ("SLSQP, all derivatives", "SLSQP, none given"):
        assert by_name[name].off_mm < 0.01  # the claim: the same optimum
        assert by_name[name].iterations > exact.iterations


def test_ceres_comes_to_the_same_joints() -> None:
    pytest.importorskip("pyceres")
    ceres = time_solvers(random_frames(2))[-1]
    assert ceres.name.startswith("Ceres")
    assert ceres.off_mm < 0.01


def test_warm_frames_are_the_problems_that_the_paper_solves() -> None:
    pairs = [pair_of(KINECT_V2, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V2, 60))]
    calibration = Calibration(KINECT_V2, A_FROM_B, KINECT_V2.nominal_lengths * 1.02, "too long, on purpose")
    fuser = Fuser(FusionSetup(calibration, FuserSettings(method="paper")))
    for pair, problem in zip(pairs, bench_update.warm_frames(pairs, calibration), strict=True):
        fused = fuser.update(pair)
        found = bench_update.TreeSolver(KINECT_V2.parent_indices, KINECT_V2.order, KINECT_V2.rest).solve(
            problem.targets, problem.weights, problem.lengths, problem.start
        )
        np.testing.assert_allclose(found.positions, fused.positions, rtol=0, atol=1e-8)


def test_the_optimum_is_the_lowest_end_with_right_bones(monkeypatch: pytest.MonkeyPatch) -> None:
    (problem,) = random_frames(1)
    right = bench_solvers.optimum(problem)
    raised = right + [0.01, 0.0, 0.0]
    monkeypatch.setattr(bench_solvers, "exact", lambda _: lambda _: (raised, 1, 1))  # a worse end,
    monkeypatch.setattr(
        bench_solvers, "slsqp", lambda analytic: lambda _: (problem.targets, 1, 1)
    )  # no bones
    np.testing.assert_allclose(bench_solvers.optimum(problem), right, rtol=0, atol=1e-8)
    worse = bench_solvers.time_solver("worse", bench_solvers.exact(problem.body), [problem], [right])
    assert worse.off_mm == pytest.approx(10.0)


def test_tables_are_whole_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    out = io.StringIO()
    console = bench_speed._wide_enough(Console(file=out))
    ends = {"exact": 4e-6, "SLSQP, all derivatives": 2e-5, "exact, warm, 25 joints, simulated": None}
    solvers = [
        Timing(name, 1000, 12345.6, 12345.6, 12345.6, 50.0, 150.0, 2.2e-13, 0.0, off)
        for name, off in ends.items()
    ]
    stages = dict.fromkeys(bench_update.STAGES, 1234.5)
    update = UpdateTiming("25 joints, simulated", "paper", 1000, stages, *[12345.6] * 5, 99999.0)
    writing = bench_speed.Writing(99999.0, 1.5, 2.4e6, 99999.0, 99999.0)
    growth = {20: 123.4, 32: 123.4, 160: 123.4}
    console.print(bench_speed._solver_table(solvers))
    console.print(bench_speed._update_table([update]))
    console.print(bench_speed._program_table(growth, writing, 0.1))
    assert "…" not in out.getvalue()
    assert "systems" in out.getvalue()
    rows = {line.strip().split("  ")[0]: line.split() for line in out.getvalue().splitlines()}
    assert rows["exact, warm, 25 joints, simulated"][-1] == "–"
    assert rows["exact"][-5:] == ["150", "2e-13", "mm", "4e-06", "mm"]


def test_every_stage_is_timed() -> None:
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 60))]
    calibration = Calibration(KINECT_V1, A_FROM_B, KINECT_V1.nominal_lengths * 1.05, "too long, on purpose")
    stages = bench_update.time_stages(pairs, calibration)
    assert list(stages) == list(bench_update.STAGES)
    assert np.isfinite(list(stages.values())).all()


def test_a_repeated_recording_has_no_jumps_and_rising_times() -> None:
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 5))]
    many = bench_update.repeated(pairs, 3)
    assert [many.index(pair) for pair in many] == list(range(15))
    assert [pair.a for pair in many] == [pair.a for pair in pairs + pairs[::-1] + pairs]
    assert {b.time_ns - a.time_ns for a, b in pairwise(many)} == {FRAME_NS}


def test_bench_speed_is_a_command_of_a_group(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[BenchSpeedOptions] = []
    monkeypatch.setattr(bench_speed, "run", given.append)
    cli.main(["bench", "speed", "--json", "speed.json", "--recording", "a.csv", "b.csv"])
    assert given == [BenchSpeedOptions(Path("speed.json"), (Path("a.csv"), Path("b.csv")))]


def test_figures_are_written_as_json(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in (("_COLD_FRAMES", 4), ("_SECONDS", 5.0), ("_SHORT", 150), ("_LONG", 300)):
        monkeypatch.setattr(bench_speed, name, value)
    monkeypatch.setattr(bench_speed, "BODIES", {"kinect_v2": KINECT_V2})
    bench_speed.run(BenchSpeedOptions(tmp_path / "speed.json"))
    figures = json.loads((tmp_path / "speed.json").read_text())
    updates = figures["updates"]
    assert [timing["name"] for timing in updates] == ["25 joints, simulated"] * 2
    assert [timing["method"] for timing in updates] == ["duplex", "paper"]  # the default first
    assert updates[0]["median_us"] > updates[1]["median_us"]  # the filter does far more per frame
    assert figures["solvers"][-1]["frames"] > 100
    assert figures["solvers"][-1]["systems"] >= figures["solvers"][-1]["iterations"]
    assert figures["solvers"][-1]["off_mm"] is None  # nobody else looked
    assert figures["writing"]["pairs_per_s"] != 0  # 150 pairs drown in the start-up's spread: no sign
    assert (
        figures["writing"]["bytes_a_minute"] > 1e6
    )  # 1800 frames of three skeletons of 25 points of 12 bytes
    assert list(figures["linear_system_us"]) == ["20", "32", "160"]


def test_writing_is_what_the_longer_recording_takes_more() -> None:
    writing = bench_speed.writing_between((600, 6600), (2.3, 5.3), (1_000_000, 7_000_000))
    assert writing.pairs_per_s == pytest.approx(2000.0)
    assert writing.start_up_s == pytest.approx(2.0)
    assert writing.bytes_a_minute == pytest.approx(1.8e6)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys\n"
        "from viewer_app.cli import main\n"
        "try:\n    main(['--help'])\nexcept SystemExit:\n    pass\n"
        "print('heavy:', *(n for n in ('numpy', 'scipy', 'numba', 'rerun', 'cv2', 'av') if n in sys.modules))"
    )
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "bench" in answer
    assert answer.strip().endswith("heavy:")


def recorded_in(folder: Path) -> tuple[Path, Path]:
    pairs = [pair_of(KINECT_V1, at, t * FRAME_NS) for t, at in enumerate(moving(KINECT_V1, 60))]
    files = folder / "a.csv", folder / "b.csv"
    for file, side in zip(files, "ab", strict=True):
        bench_speed._write_csv(file, KINECT_V1, pairs, side)
    return files


def test_writing_is_timed_with_the_recording_where_one_is_given(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    class TimedError(Exception):
        pass

    def time_writing(body: Body, pairs: list[SkeletonPair]) -> None:
        raise TimedError(body.name, len(pairs))

    for name, value in (("_COLD_FRAMES", 2), ("_SECONDS", 5.0), ("BODIES", {"kinect_v2": KINECT_V2})):
        monkeypatch.setattr(bench_speed, name, value)
    monkeypatch.setattr(bench_speed, "time_solvers", lambda problems: [])
    monkeypatch.setattr(bench_speed, "time_writing", time_writing)
    with pytest.raises(TimedError) as timed:
        bench_speed.run(BenchSpeedOptions(recording=recorded_in(tmp_path)))
    assert timed.value.args == (KINECT_V1.name, 60)


@pytest.mark.parametrize("wrong", ["recording", "json"])
def test_wrong_options_are_reported_before_the_first_timing(
    wrong: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(bench_speed, "time_solvers", lambda problems: pytest.fail("timed"))
    monkeypatch.setattr(bench_speed, "BODIES", {})
    a, b = recorded_in(tmp_path)
    if wrong == "recording":
        b.write_text("no recording")
        options = BenchSpeedOptions(recording=(a, b))
    else:  # as on a file system that is full, or read-only in a way that permissions do not tell

        def full(**_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(bench_speed.tempfile, "TemporaryFile", full)
        options = BenchSpeedOptions(tmp_path / "speed.json", (a, b))
    with pytest.raises((DeviceError, UsageError)):
        bench_speed.run(options)
