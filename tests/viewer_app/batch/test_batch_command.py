"""``duplex batch`` in processes of this machine: sessions, resuming, bad pairs, interruption."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from fusion.setup import REVISIONS
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.machine import small_disk
from tests.helpers.recorded_pairs import assert_same_session, write_pair
from tests.helpers.waiting import eventually
from viewer_app.batch import processes
from viewer_app.batch.finding import Pair
from viewer_app.batch.jobs import Job, Outcome
from viewer_app.batch.processes import run_in_processes
from viewer_app.batch.worker import fuse_job
from viewer_app.options.sensing import BatchOptions

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture
def in_this_process(monkeypatch):
    """Makes the command fuse in this process; returns the names of the fused pairs."""
    fused = []

    def run(jobs, _):
        for job in jobs:
            fused.append(job.name)
            yield fuse_job(job)

    monkeypatch.setattr(processes, "run_in_processes", run)
    return fused


def table(out):
    return pq.read_table(out / "summary.parquet").to_pydict()


def files_in(out):
    return {str(path.relative_to(out)) for path in out.rglob("*") if path.is_file()}


def files_of(name):
    return {f"{name}/{name}.rrd", f"{name}/{name}.json", f"{name}/record.json"}


def started(*arguments):
    command = [sys.executable, "-m", "viewer_app.cli", "batch", *map(str, arguments)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=ROOT, **pipes, start_new_session=True)


def test_two_processes_fuse_what_duplex_fuse_fuses(tmp_path):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    for seed in range(3):
        write_pair(pairs / f"p{seed}", seed=seed)
    (pairs / "p1" / "b.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    assert duplex("batch", pairs, "--out", out, "--processes", 2, "--smooth", "whole") == 1
    assert files_in(out) == {"summary.html", "summary.parquet"} | files_of("p0") | files_of("p2")
    alone = tmp_path / "alone.rrd"
    pair = pairs / "p2" / "a.csv", pairs / "p2" / "b.csv"
    assert duplex("fuse", *pair, "--smooth", "whole", "--no-viewer", "--save", alone) == 0
    assert_same_session(out / "p2" / "p2.rrd", alone)
    rows = table(out)
    assert rows["name"][0] == "p1"
    assert rows["state"] == ["failed", "fused", "fused"]
    assert "b.csv" in str(rows["error"][0])
    assert rows["frames"] == [None, 75, 75]
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert page.index("p1") < page.index('href="p0/p0.rrd"')
    assert "p1/p1" not in page  # no link to a session that is not there


def test_on_a_full_disk_every_pair_ends_with_one_line(tmp_path, capsys):
    for name in "pq":
        write_pair(tmp_path / "pairs" / name)
    assert (
        duplex(
            "fuse", *sorted((tmp_path / "pairs" / "p").iterdir()), "--no-viewer", "--save", tmp_path / "s.rrd"
        )
        == 0
    )
    kilobytes = 0.8 * (tmp_path / "s.rrd").stat().st_size / 1024
    capsys.readouterr()
    with small_disk(tmp_path / "small", round(kilobytes)) as disk:
        assert duplex("batch", tmp_path / "pairs", "--out", disk / "out", "--processes", 2) == 1
        said = " ".join(capsys.readouterr().out.split())
        assert said.count("could not be written") == 2
        assert files_in(disk / "out") <= {"summary.html", "summary.parquet"}
        assert not (disk / "out" / ".partial").exists()


def test_only_what_is_not_done_is_fused(tmp_path, in_this_process, capsys):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=1)
    write_pair(pairs, "two_a.csv", "two_b.csv", seed=2)
    assert duplex("batch", pairs, "--out", out) == 0
    assert in_this_process == ["one", "two"]
    # without a terminal there is no progress bar
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == ["one: fused, 1 of 2.", "two: fused, 2 of 2."]
    (out / "two" / "two.rrd").unlink()  # no longer complete
    write_pair(pairs, "six_a.csv", "six_b.csv", seed=6)
    assert duplex("batch", pairs, "--out", out) == 0
    assert in_this_process == ["one", "two", "six", "two"]
    assert table(out)["state"] == ["fused"] * 3
    capsys.readouterr()

    # neither another option nor another input replaces a session silently
    assert duplex("batch", pairs, "--out", out, "--smoothing", "0.9") == 2
    assert "with another --smoothing" in one_line(capsys)
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=3)
    assert duplex("batch", pairs, "--out", out) == 2
    assert "one was fused from other recordings" in one_line(capsys)
    assert len(in_this_process) == 4
    before = (out / "one" / "one.rrd").read_bytes()
    assert duplex("batch", pairs, "--out", out, "--force") == 0
    assert in_this_process[4:] == ["one"]
    assert (out / "one" / "one.rrd").read_bytes() != before
    (out / "one" / "one.bvh").touch()
    assert duplex("batch", pairs, "--out", out, "--force") == 2
    assert "one holds files that duplex batch did not write (one.bvh)" in one_line(capsys)


def test_sessions_of_another_revision_are_fused_again(tmp_path, in_this_process, monkeypatch, capsys):
    write_pair(tmp_path / "pairs" / "p")
    given = ("batch", tmp_path / "pairs", "--out", tmp_path / "out", "--method", "paper")
    assert duplex(*given) == 0
    monkeypatch.setitem(REVISIONS, "duplex", REVISIONS["duplex"] + 1)
    assert duplex(*given) == 0
    assert in_this_process == ["p"], "another method has changed"
    monkeypatch.setitem(REVISIONS, "paper", 2)
    assert duplex(*given) == 2
    assert "was fused by revision 1 of its method; this is 2." in one_line(capsys)
    assert duplex(*given, "--force") == 0
    assert duplex(*given) == 0
    assert in_this_process == ["p", "p"]


def test_a_replacement_that_fails_keeps_the_old_session(tmp_path, in_this_process):
    pairs, out = write_pair(tmp_path / "pairs" / "p"), tmp_path / "out"
    assert duplex("batch", pairs.parent, "--out", out) == 0
    before = (out / "p" / "p.rrd").read_bytes()
    (pairs / "a.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    assert duplex("batch", pairs.parent, "--out", out, "--force") == 1
    assert (out / "p" / "p.rrd").read_bytes() == before
    assert files_in(out) == {"summary.html", "summary.parquet"} | files_of("p")
    assert in_this_process == ["p", "p"]


def test_a_session_that_was_being_replaced_returns(tmp_path, in_this_process):
    pairs, out = write_pair(tmp_path / "pairs" / "p"), tmp_path / "out"
    assert duplex("batch", pairs.parent, "--out", out) == 0
    # the state after a kill between the two renames
    (out / ".partial" / "p.host-1").mkdir(parents=True)
    (out / "p").rename(out / ".partial" / "p.old")
    assert duplex("batch", pairs.parent, "--out", out) == 0
    assert in_this_process == ["p"]
    assert files_in(out) == {"summary.html", "summary.parquet"} | files_of("p")
    assert duplex("batch", pairs.parent, "--out", out, "--pages") == 0
    assert files_in(out) == {"summary.html", "summary.parquet", "p/p.html"} | files_of("p")
    assert 'href="p/p.html"' in (out / "summary.html").read_text(encoding="utf-8")


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_killed_half_way_and_resumed(number, tmp_path, in_this_process):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    for seed in range(4):
        write_pair(pairs / f"p{seed}", seed=seed)
    batch = started(pairs, "--out", out, "--processes", 1)
    try:
        assert eventually(lambda: (out / "p0").exists(), 240.0)
        # Ctrl-C reaches the whole group of a terminal; a kill only the process
        (os.killpg if number == signal.SIGINT else os.kill)(batch.pid, number)
        _, said = batch.communicate(timeout=60.0)
    finally:
        batch.kill()
    done = sorted(path.name for path in out.glob("p*"))
    assert len(done) < 4
    assert all(files_of(name) <= files_in(out) for name in done)
    if number == signal.SIGINT:
        assert batch.returncode == 130
        assert said == "duplex: stopped\n"
        assert table(out)["state"].count("pending") == 4 - len(done)
        assert not (out / ".partial").exists()
    made = {name: (out / name / f"{name}.rrd").stat().st_mtime_ns for name in done}
    assert duplex("batch", pairs, "--out", out, "--processes", 1) == 0
    assert in_this_process == [f"p{k}" for k in range(4) if f"p{k}" not in done]
    assert {name: (out / name / f"{name}.rrd").stat().st_mtime_ns for name in done} == made
    assert table(out)["state"] == ["fused"] * 4
    assert not (out / ".partial").exists()
    assert len(Session.open(out / "p3" / "p3.rrd")) == 75


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_worker_that_dies_costs_its_own_job_only(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "compile_kernels", lambda _: None)
    monkeypatch.setattr(processes, "fuse_job", dies_on_p)
    outcomes = list(run_in_processes([_job(tmp_path, name) for name in "pqr"], 1))
    assert [(each.name, each.error) for each in outcomes] == [
        ("p", "The worker process died (SIGKILL, often too little memory)."),
        ("q", ""),
        ("r", ""),
    ]


def dies_on_p(job):
    if job.name == "p":
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome(job.name, {})


def test_a_job_that_a_cluster_repeats_is_not_fused_again(tmp_path):
    folder = write_pair(tmp_path / "pairs" / "p")
    options = BatchOptions(source=folder.parent, out=tmp_path / "out")
    job = Job(Pair("p", folder / "a.csv", folder / "b.csv"), options)
    first = fuse_job(job)
    # another worker may be about to make its own folder in this one
    assert list((tmp_path / "out" / ".partial").iterdir()) == []
    made = job.session.stat().st_mtime_ns
    assert fuse_job(job) == first
    assert job.session.stat().st_mtime_ns == made


def _job(folder, name):
    options = BatchOptions(source=folder, out=folder)
    return Job(Pair(name, folder / "a.csv", folder / "b.csv"), options)
