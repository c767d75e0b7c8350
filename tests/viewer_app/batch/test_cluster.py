"""``duplex batch --scheduler``: on a Dask cluster in this process, and on one of programs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import REAL, assert_same_session, write_pair
from tests.helpers.waiting import eventually
from viewer_app.batch import cluster

distributed = pytest.importorskip("distributed")

ROOT = Path(__file__).resolve().parents[3]
_START = 300.0
"""Seconds within which programs start. A busy machine takes 20 times as long as an idle one."""


@pytest.fixture
def local_cluster() -> Iterator[str]:
    """The address of a cluster with two workers in this process."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address=None,
    ) as made:
        yield made.scheduler_address


def program(*arguments: object) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, arguments)],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def address_in(file: Path) -> str:
    """The address in a scheduler's file; empty until the file is whole."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["address"])
    except (OSError, ValueError):
        return ""


def states(out: Path) -> list[str]:
    found: list[str] = pq.read_table(out / "summary.parquet").to_pydict()["state"]
    return found


def test_the_real_pairs_on_a_local_cluster(shared: Path, tmp_path: Path, local_cluster: str) -> None:
    out = tmp_path / "out"
    assert duplex("batch", shared / "real", "--out", out, "--scheduler", local_cluster) == 0
    assert states(out) == ["fused"] * len(REAL)
    name = f"kinect_v2_90deg_{REAL[0]}"
    pair = shared / "real" / name / "a.csv", shared / "real" / name / "b.csv"
    assert duplex("fuse", *pair, "--no-viewer", "--save", tmp_path / "alone.rrd") == 0
    assert_same_session(out / name / f"{name}.rrd", tmp_path / "alone.rrd")


def test_a_bad_pair_and_a_wrong_address(
    tmp_path: Path, local_cluster: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    write_pair(pairs / "good")
    write_pair(pairs / "bad")
    (pairs / "bad" / "a.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    assert duplex("batch", pairs, "--out", out, "--scheduler", local_cluster) == 1
    assert states(out) == ["failed", "fused"]
    assert "bad: " in capsys.readouterr().out
    monkeypatch.setattr(cluster, "_CONNECT_WITHIN", 0.5)
    assert duplex("batch", pairs, "--out", tmp_path / "o", "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "no Dask scheduler answers there" in one_line(capsys)


def test_a_scheduler_and_two_workers_as_programs_killed_half_way_and_resumed(tmp_path: Path) -> None:
    pairs, out, file = tmp_path / "pairs", tmp_path / "out", tmp_path / "scheduler.json"
    for seed in range(4):
        write_pair(pairs / f"p{seed}", seed=seed)
    with ExitStack() as stack:

        def start(*arguments: object) -> subprocess.Popen[bytes]:
            process = program(*arguments)
            stack.callback(process.wait)
            stack.callback(process.kill)
            return process

        quiet = "--no-dashboard", "--scheduler-file", file
        start("distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", 0, *quiet)
        own = "--no-nanny", "--nthreads", 1, "--local-directory", tmp_path
        workers = [start("distributed.cli.dask_worker", *quiet, *own) for _ in range(2)]
        assert eventually(lambda: address_in(file) != "", _START)
        address = address_in(file)
        with distributed.Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=_START)
        batch = start("viewer_app.cli", "batch", pairs, "--out", out, "--scheduler", address)
        assert eventually(lambda: any(out.glob("p*")) or batch.poll() is not None, _START)
        batch.kill()
        workers[0].kill()
        batch.wait()
        workers[0].wait()
        assert not (out / "summary.html").exists()  # it was killed before the end
        made = {path: path.stat().st_mtime_ns for path in out.glob("p*/*.rrd")}
        assert duplex("batch", pairs, "--out", out, "--scheduler", address) == 0
        assert states(out) == ["fused"] * 4
        assert {path: path.stat().st_mtime_ns for path in made} == made
        assert not (out / ".partial").exists()


def test_without_dask_one_line_names_the_extra(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_pair(tmp_path / "pairs")
    monkeypatch.setitem(sys.modules, "distributed", None)
    arguments = tmp_path / "pairs", "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9"
    assert duplex("batch", *arguments) == 2
    assert "pip install 'duplex-kinects[cluster]'" in one_line(capsys)
