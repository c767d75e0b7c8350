"""``duplex batch --scheduler``: on a Dask cluster in this process, and on one of programs."""

import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest

from tests.helpers.command_line import duplex, one_line
from tests.helpers.recorded_pairs import assert_same_session, write_pair
from viewer_app.batch import cluster
from viewer_app.batch.jobs import Outcome

distributed = pytest.importorskip("distributed")

PLAIN = "--method", "paper"
"""The fastest method: these tests are about the cluster."""


@pytest.fixture
def local_cluster():
    """The address of a cluster with two workers in this process."""
    workers = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    address = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(**workers, **address) as made:
        yield made.scheduler_address


def states(out):
    return pq.read_table(out / "summary.parquet").to_pydict()["state"]


def test_a_local_cluster_fuses_what_duplex_fuse_fuses(tmp_path, local_cluster):
    pairs, out, alone = tmp_path / "pairs", tmp_path / "out", tmp_path / "alone.rrd"
    for seed in range(3):
        write_pair(pairs / f"p{seed}", seed=seed)
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--scheduler", local_cluster) == 0
    assert states(out) == ["fused"] * 3
    pair = pairs / "p1" / "a.csv", pairs / "p1" / "b.csv"
    assert duplex("fuse", *pair, *PLAIN, "--no-viewer", "--save", alone) == 0
    assert_same_session(out / "p1" / "p1.rrd", alone)


def test_a_bad_pair_and_a_wrong_address(tmp_path, local_cluster, capsys, monkeypatch):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    write_pair(pairs / "good")
    write_pair(pairs / "bad")
    (pairs / "bad" / "a.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--scheduler", local_cluster) == 1
    assert states(out) == ["failed", "fused"]
    assert "bad: " in capsys.readouterr().out
    monkeypatch.setattr(cluster, "_CONNECT_WITHIN", 0.5)
    assert duplex("batch", pairs, "--out", tmp_path / "o", "--scheduler", "tcp://127.0.0.1:9") == 2
    assert "no Dask scheduler answers there" in one_line(capsys)


def test_a_session_that_is_not_here_has_failed(tmp_path, local_cluster, monkeypatch, capsys):
    """The workers have another disk under the same path."""
    write_pair(tmp_path / "pairs" / "one")
    monkeypatch.setattr(cluster, "fuse_job", fused_elsewhere)
    monkeypatch.setattr(cluster, "_SEEN_WITHIN", 0.1)
    given = tmp_path / "pairs", "--out", tmp_path / "out", *PLAIN, "--scheduler", local_cluster
    assert duplex("batch", *given) == 1
    assert "is not shared" in capsys.readouterr().out
    assert states(tmp_path / "out") == ["failed"]


def test_the_session_before_is_not_taken_for_a_new_one(monkeypatch):
    """``--force``: the older session is here, and the worker's is on another disk."""
    monkeypatch.setattr(cluster, "_SEEN_WITHIN", 0.1)
    before, now = ({"identity": {"files": name}, "figures": {}} for name in ("before", "now"))
    job = SimpleNamespace(name="one", folder="out/one", record=lambda: before)
    assert "is not shared" in cluster._seen_here(job, Outcome("one", now)).error
    assert cluster._seen_here(job, Outcome("one", before)).record is before


def fused_elsewhere(job):
    return Outcome(job.name, {"identity": {}, "figures": {}})


def test_that_no_worker_is_left_is_said_and_ends_it(monkeypatch):
    """The worker is lost while it fuses, and none comes instead."""
    monkeypatch.setattr(cluster, "fuse_job", fused_never)
    monkeypatch.setattr(cluster, "_GIVES_UP_AFTER", 0.5)
    workers = {"n_workers": 1, "threads_per_worker": 1, "processes": False}
    address = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    FUSING.clear()
    said = []
    with distributed.LocalCluster(**workers, **address) as made:
        jobs = [SimpleNamespace(name=str(k)) for k in range(2)]
        with ThreadPoolExecutor(1) as pool:
            running = pool.submit(
                lambda: list(cluster.run_on_cluster(jobs, made.scheduler_address, said.append))
            )
            assert FUSING.wait(10.0)
            made.sync(made.workers[0].close, executor_wait=False)
            LEFT.set()
            outcomes = running.result(20.0)
    assert [outcome.error for outcome in outcomes] == ["No worker was left."] * 2
    assert len(said) == 1


FUSING, LEFT = threading.Event(), threading.Event()


def fused_never(_):
    FUSING.set()
    LEFT.wait(20.0)


def test_without_dask_one_line_names_the_extra(tmp_path, capsys, monkeypatch):
    write_pair(tmp_path / "pairs")
    monkeypatch.setitem(sys.modules, "distributed", None)
    arguments = tmp_path / "pairs", "--out", tmp_path / "out", "--scheduler", "tcp://127.0.0.1:9"
    assert duplex("batch", *arguments) == 2
    assert 'pip install "duplex-kinects[cluster]"' in one_line(capsys)
