"""``duplex batch`` in processes of this machine: sessions, resuming, bad pairs, interruption."""

import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import numpy as np
import psutil
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.setup import REVISIONS
from recordings.calibration_file import calibration_to_json
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.dying_worker import DEADLY, fuses_or_dies
from tests.helpers.machine import small_disk
from tests.helpers.recorded_pairs import assert_same_session, write_pair
from tests.helpers.screens import browser
from tests.helpers.waiting import eventually
from viewer_app.batch import cluster, processes, worker
from viewer_app.batch.command import usable_processors
from viewer_app.batch.finding import Pair, find_pairs
from viewer_app.batch.jobs import Job, Outcome, checksum
from viewer_app.batch.manifest import read_manifest
from viewer_app.batch.summary import RANKED, Row, worst_first, write_page, write_parquet
from viewer_app.batch.worker import fuse_job
from viewer_app.commands.fuse import fuse_files
from viewer_app.errors import UsageError
from viewer_app.options.sensing import BatchOptions
from viewer_app.report.pages import review_page

ROOT = Path(__file__).resolve().parents[3]


PLAIN = "--method", "paper"
"""The fastest method: these tests are about the batch."""


@pytest.fixture
def in_this_process(monkeypatch):
    """See :func:`fusing_here`."""
    return fusing_here(monkeypatch)


def fusing_here(monkeypatch):
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


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_two_processes_fuse_what_duplex_fuse_fuses(tmp_path, monkeypatch):
    """A pair that cannot be read, and one at which the worker dies, cost the others nothing."""
    monkeypatch.setattr(processes, "fuse_job", fuses_or_dies)
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    for seed, name in enumerate((DEADLY, "p1", "p2", "p3")):
        write_pair(pairs / name, seed=seed)
    (pairs / "p1" / "b.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    options = "--smooth", "whole"
    assert duplex("batch", pairs, "--out", out, "--processes", 2, *options) == 1
    assert files_in(out) == {"summary.html", "summary.parquet"} | files_of("p2") | files_of("p3")
    page = (ROOT / "docs" / "batch.md").read_text(encoding="utf-8")
    (columns,) = re.findall(r"columns:\n\n```text\n(.*?)```", page, re.DOTALL)
    rows = re.findall(r"^(\w+(?:, \w+)*)  ", columns, re.MULTILINE)
    assert sorted(name for row in rows for name in row.split(", ")) == sorted(table(out))
    alone = tmp_path / "alone.rrd"
    pair = pairs / "p3" / "a.csv", pairs / "p3" / "b.csv"
    assert duplex("fuse", *pair, *options, "--no-viewer", "--save", alone) == 0
    assert_same_session(out / "p3" / "p3.rrd", alone)
    rows = table(out)
    of = {name: number for number, name in enumerate(rows["name"])}
    assert sorted(rows["name"][:2]) == [DEADLY, "p1"]
    assert rows["state"] == ["failed", "failed", "fused", "fused"]
    assert rows["error"][of[DEADLY]] == "The worker process died (SIGKILL, often too little memory)."
    assert "b.csv" in rows["error"][of["p1"]]
    assert rows["frames"] == [None, None, 75, 75]
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert page.index("p1") < page.index('href="p2/p2.rrd"')
    assert "p1/p1" not in page  # no link to a session that is not there


def test_on_a_full_disk_every_pair_ends_with_one_line(tmp_path, in_this_process, capsys):
    for name in "pq":
        write_pair(tmp_path / "pairs" / name)
    pair = sorted((tmp_path / "pairs" / "p").iterdir())
    assert duplex("fuse", *pair, *PLAIN, "--no-viewer", "--save", tmp_path / "s.rrd") == 0
    kilobytes = 0.8 * (tmp_path / "s.rrd").stat().st_size / 1024
    capsys.readouterr()
    with small_disk(tmp_path / "small", round(kilobytes)) as disk:
        assert duplex("batch", tmp_path / "pairs", "--out", disk / "out", *PLAIN) == 1
        assert in_this_process == ["p", "q"]
        said = " ".join(capsys.readouterr().out.split())
        assert said.count("could not be written") == 2
        assert files_in(disk / "out") <= {"summary.html", "summary.parquet"}
        assert not (disk / "out" / ".partial").exists()


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="only Linux gives a process fewer processors"
)
def test_processors_that_may_not_be_used_do_not_count():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, [min(before)])
        assert usable_processors() == 1
    finally:
        os.sched_setaffinity(0, before)
    assert usable_processors() == len(before)


def test_only_what_is_not_done_is_fused(tmp_path, in_this_process, capsys):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=1)
    write_pair(pairs, "two_a.csv", "two_b.csv", seed=2)
    assert duplex("batch", pairs, "--out", out, *PLAIN) == 0
    assert in_this_process == ["one", "two"]
    # without a terminal there is no progress bar
    said = capsys.readouterr().out.splitlines()
    assert said[:2] == ["one: fused, 1 of 2.", "two: fused, 2 of 2."]
    (out / "two" / "two.rrd").unlink()  # no longer complete
    write_pair(pairs, "six_a.csv", "six_b.csv", seed=6)
    assert duplex("batch", pairs, "--out", out, *PLAIN) == 0
    assert in_this_process == ["one", "two", "six", "two"]
    assert table(out)["state"] == ["fused"] * 3
    capsys.readouterr()

    # neither another option nor another input replaces a session silently
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--h", "0.9") == 2
    assert "with another --h" in one_line(capsys)
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=3)
    assert duplex("batch", pairs, "--out", out, *PLAIN) == 2
    assert "one was fused from other recordings" in one_line(capsys)
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=1)
    # somebody else's file harms neither a session that stays nor the others
    (out / "one" / "one.bvh").touch()
    capsys.readouterr()
    assert duplex("batch", pairs, "--out", out, *PLAIN) == 0
    write_pair(pairs, "one_a.csv", "one_b.csv", seed=4)
    write_pair(pairs, "two_a.csv", "two_b.csv", seed=4)
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--force") == 1
    assert in_this_process[4:] == ["two"]
    assert "holds files that duplex batch did not write: one.bvh." in capsys.readouterr().out
    assert sorted(table(out)["state"]) == ["failed", "fused", "fused"]


class KilledError(BaseException):
    """The process ends here: nothing is tidied."""


@cache
def one_session():
    """A session and the figures of its report, whatever is fused."""
    with TemporaryDirectory() as folder:
        pair = write_pair(Path(folder) / "pairs" / "p")
        options = BatchOptions(source=pair.parent, out=Path(folder) / "out", method="paper")
        fused = Job(Pair("p", pair / "a.csv", pair / "b.csv"), options).fuse_options(Path(folder))
        return fuse_files(fused, Console(file=StringIO()))


def fused_at_once(options, _):
    """The session's file says what it was made of."""
    options.save.write_text(f"{options.a.read_text()}{options.b.read_text()}{options.h}")
    options.report.write_text("{}")
    return one_session()[0], dict(one_session()[1])


def dies_at(monkeypatch, rename):
    """The process is killed at the n-th time that a folder gets another name; never if there are fewer."""
    left, real = [rename], Path.rename

    def counted(path, to):
        if left[0] == 0:
            monkeypatch.setattr(Path, "rename", dies)
            monkeypatch.setattr(shutil, "rmtree", dies)
            raise KilledError
        left[0] -= 1
        return real(path, to)

    def dies(*_, **__):
        raise KilledError

    monkeypatch.setattr(Path, "rename", counted)


RUNS = st.lists(
    st.fixed_dictionaries(
        {
            "inputs": st.sampled_from([None, None, "other", "unreadable"]),
            "h": st.sampled_from([0.6, 0.6, 0.9]),
            "pages": st.booleans(),
            "force": st.sampled_from([False, False, True]),
            "dies": st.none() | st.integers(0, 3),
            "lost": st.sets(st.sampled_from(["rrd", "json", "html", "record"]), max_size=1),
        }
    ),
    min_size=2,
    max_size=5,
)


@given(RUNS)
def test_whatever_happened_before_no_session_is_lost_and_none_is_taken_for_another(runs):
    with TemporaryDirectory() as at, pytest.MonkeyPatch.context() as patched:
        pairs, out, version = Path(at) / "pairs", Path(at) / "out", {"p": 0, "q": 0}
        patched.setattr(worker, "fuse_files", fused_at_once)
        patched.setattr(worker, "truth_free_figures", lambda _: {})
        patched.setattr(review_page, "review_page", lambda *_: "")
        fusing_here(patched)
        for run in runs:
            for name, number in version.items():
                if run["inputs"] == "other" and name == "p":
                    version[name] = number + 1
                (pairs / name).mkdir(parents=True, exist_ok=True)
                for side in "ab":
                    (pairs / name / f"{side}.csv").unlink(missing_ok=True)
                    (pairs / name / f"{side}.csv").write_text(f"{name}{side}{version[name]} ")
            if run["inputs"] == "unreadable":
                (pairs / "p" / "a.csv").unlink()
                (pairs / "p" / "a.csv").symlink_to("nowhere")
            for lost in run["lost"]:
                (out / "p" / ("record.json" if lost == "record" else f"p.{lost}")).unlink(missing_ok=True)
            right = {name: f"{name}a{k} {name}b{k} {run['h']}" for name, k in version.items()}
            before = {path.stem: path.read_text() for path in out.glob("*/*.rrd")}
            old = {path.stem: path.stem for path in out.glob(".partial/*.old/*.rrd")}
            command = "batch", pairs, "--out", out, *PLAIN, "--h", run["h"]
            command += tuple(f"--{each}" for each in ("pages", "force") if run[each])
            code, killed = None, False
            with pytest.MonkeyPatch.context() as this_time:
                if run["dies"] is not None:
                    dies_at(this_time, run["dies"])
                try:
                    code = duplex(*command)
                except KilledError:
                    killed = True
            there = {path.stem: path.read_text() for path in out.glob("*/*.rrd")}
            kept = {path.stem: path.read_text() for path in out.glob(".partial/*.old/*.rrd")}
            assert before.keys() | old.keys() <= there.keys() | kept.keys()
            for name, content in there.items():
                changed = content != before.get(name, content)
                assert not changed or run["force"]
                assert not changed or content == right[name]
            if run["inputs"] != "unreadable" and (run["force"] or not before) and not killed:
                assert code == 0
            if code == 0:
                assert there == right
                assert run["inputs"] != "unreadable"
            assert killed or code in (0, 1, 2)


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


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs POSIX signals")
def test_interrupted_half_way_and_resumed(tmp_path, monkeypatch, capfd):
    monkeypatch.setattr(processes, "warm_up", lambda *_, **__: None)
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    for seed in range(4):
        write_pair(pairs / f"p{seed}", seed=seed)

    def press():
        """Ctrl-C reaches the whole group of a terminal."""
        if eventually(lambda: (out / "p0").exists(), 240.0):
            for process in (*psutil.Process().children(), psutil.Process()):
                process.send_signal(signal.SIGINT)

    pressing = threading.Thread(target=press)
    pressing.start()
    assert duplex("batch", pairs, "--out", out, "--processes", 1, *PLAIN) == 130
    pressing.join()
    assert capfd.readouterr().err == "duplex: stopped\n"
    done = sorted(path.name for path in out.glob("p*"))
    assert len(done) < 4
    assert all(files_of(name) <= files_in(out) for name in done)
    assert table(out)["state"].count("pending") == 4 - len(done)
    assert not (out / ".partial").exists()
    made = {name: (out / name / f"{name}.rrd").stat().st_mtime_ns for name in done}
    fused = fusing_here(monkeypatch)
    assert duplex("batch", pairs, "--out", out, "--processes", 1, *PLAIN) == 0
    assert fused == [f"p{k}" for k in range(4) if f"p{k}" not in done]
    assert {name: (out / name / f"{name}.rrd").stat().st_mtime_ns for name in done} == made
    assert table(out)["state"] == ["fused"] * 4
    assert not (out / ".partial").exists()
    assert len(Session.open(out / "p3" / "p3.rrd")) == 75


def test_a_session_that_an_interrupted_run_did_not_replace_is_pending(tmp_path, monkeypatch):
    for name in ("one", "two"):
        write_pair(tmp_path / "pairs" / name)
    fusing_here(monkeypatch)
    given = "batch", tmp_path / "pairs", "--out", tmp_path / "out", *PLAIN
    assert duplex(*given) == 0

    def stopped(jobs, _):
        yield fuse_job(jobs[0])
        raise KeyboardInterrupt

    monkeypatch.setattr(processes, "run_in_processes", stopped)
    assert duplex(*given, "--h", 0.9, "--force") == 130
    assert sorted(table(tmp_path / "out")["state"]) == ["fused", "pending"]


WORKER = """
import threading
from multiprocessing import get_context
from viewer_app.batch.processes import _begin

def work():
    _begin()
    print("works", flush=True)
    threading.Event().wait()

get_context("fork").Process(target=work).start()
"""


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs POSIX signals")
def test_a_worker_ends_with_a_batch_that_is_killed():
    batch = subprocess.Popen([sys.executable, "-c", WORKER], cwd=ROOT, stdout=subprocess.PIPE)
    assert batch.stdout.readline() == b"works\n"
    batch.kill()
    assert batch.communicate(timeout=60.0) == (b"", None)  # nobody holds the pipe any more


def test_a_job_that_a_cluster_repeats_is_not_fused_again(tmp_path):
    folder = write_pair(tmp_path / "pairs" / "p")
    options = BatchOptions(source=folder.parent, out=tmp_path / "out", method="paper")
    job = Job(Pair("p", folder / "a.csv", folder / "b.csv"), options)
    first = fuse_job(job)
    # another worker may be about to make its own folder in this one
    assert list((tmp_path / "out" / ".partial").iterdir()) == []
    made = job.session.stat().st_mtime_ns
    assert fuse_job(job) == first
    assert job.session.stat().st_mtime_ns == made


# --- ``duplex batch --scheduler``: on a Dask cluster in this process, and on one of programs.


@pytest.fixture
def local_cluster():
    """The address of a cluster with two workers in this process."""
    distributed = pytest.importorskip("distributed")
    workers = {"n_workers": 2, "threads_per_worker": 1, "processes": False}
    address = {"protocol": "tcp", "host": "127.0.0.1", "dashboard_address": None}
    with distributed.LocalCluster(**workers, **address) as made:
        yield made.scheduler_address


def test_a_local_cluster_fuses_what_duplex_fuse_fuses(tmp_path, local_cluster):
    pairs, out, alone = tmp_path / "pairs", tmp_path / "out", tmp_path / "alone.rrd"
    for seed in range(3):
        write_pair(pairs / f"p{seed}", seed=seed)
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--scheduler", local_cluster) == 0
    assert table(out)["state"] == ["fused"] * 3
    pair = pairs / "p1" / "a.csv", pairs / "p1" / "b.csv"
    assert duplex("fuse", *pair, *PLAIN, "--no-viewer", "--save", alone) == 0
    assert_same_session(out / "p1" / "p1.rrd", alone)


def test_a_bad_pair_and_a_wrong_address(tmp_path, local_cluster, closed_port, capsys, monkeypatch):
    pairs, out = tmp_path / "pairs", tmp_path / "out"
    write_pair(pairs / "good")
    write_pair(pairs / "bad")
    (pairs / "bad" / "a.csv").write_text("time_us,body\n1\n", encoding="utf-8")
    assert duplex("batch", pairs, "--out", out, *PLAIN, "--scheduler", local_cluster) == 1
    assert table(out)["state"] == ["failed", "fused"]
    assert "bad: " in capsys.readouterr().out
    monkeypatch.setattr(cluster, "_CONNECT_WITHIN", 0.5)
    nowhere = f"tcp://127.0.0.1:{closed_port}"
    assert duplex("batch", pairs, "--out", tmp_path / "o", "--scheduler", nowhere) == 2
    assert "no Dask scheduler answers there" in one_line(capsys)


def test_a_session_that_is_not_here_has_failed(tmp_path, local_cluster, monkeypatch, capsys):
    """The workers have another disk under the same path."""
    write_pair(tmp_path / "pairs" / "one")
    monkeypatch.setattr(cluster, "fuse_job", fused_elsewhere)
    monkeypatch.setattr(cluster, "_SEEN_WITHIN", 0.1)
    given = tmp_path / "pairs", "--out", tmp_path / "out", *PLAIN, "--scheduler", local_cluster
    assert duplex("batch", *given) == 1
    assert "is not shared" in capsys.readouterr().out
    assert table(tmp_path / "out")["state"] == ["failed"]


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
    distributed = pytest.importorskip("distributed")
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


# --- The pairs of a folder or a manifest, and the summary: order, table and page.


def touch(root, *names):
    for name in names:
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).touch()


FOLDERS = [
    ("b.json a.json walk_a.csv walk_b.csv x.csv", "here=a.json+b.json walk=walk_a.csv+walk_b.csv"),
    ("anna/a.csv anna/b.csv anna/x.txt", "anna=anna/a.csv+anna/b.csv"),
    ("anna/run_A.skeleton anna/run_B.skeleton", "anna_run=anna/run_A.skeleton+anna/run_B.skeleton"),
    ("a.csv b.csv ._a.csv ._b.csv w/a.csv w/b.csv w/._a.csv .DS_Store", "here=a.csv+b.csv w=w/a.csv+w/b.csv"),
    ("w_a.csv w_b.json a.csv b.csv", "here=a.csv+b.csv; w_a.csv w_b.json"),
    ("w_a.mkv w_b.mkv w_a.json w_b.csv", "w=w_a.mkv+w_b.mkv+w_a.json+w_b.csv"),
    ("w/a.csv w/b.csv out/x/a.csv out/x/b.csv .old/a.csv .old/b.csv", "w=w/a.csv+w/b.csv"),
]
"""Files, and the pairs that they are; behind the semicolon those without a partner. macOS adds some."""


@pytest.mark.parametrize(("files", "expected"), FOLDERS)
def test_the_pairs_in_a_folder_that_links_to_itself(files, expected, tmp_path):
    here = tmp_path / "here"
    touch(here, *files.split())
    (here / "loop").symlink_to(here)
    pairs, left = find_pairs(here, here / "out")
    named, _, alone = expected.partition("; ")
    of = [(pair.name, "+".join(path.relative_to(here).as_posix() for path in pair.files)) for pair in pairs]
    assert of == [tuple(each.split("=")) for each in named.split()]
    assert left == [f"{here / name} has no partner and is skipped." for name in alone.split()]


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ("anna/walk_a.csv anna/walk_b.csv anna_walk/a.csv anna_walk/b.csv", "both be session anna_walk"),
        ("summary.parquet_a.csv summary.parquet_b.csv", "would be session summary.parquet"),
        ("SUMMARY.html_a.csv SUMMARY.html_b.csv", "would be session SUMMARY.html"),
    ],
)
def test_no_session_takes_the_place_of_another_or_of_the_summary(files, said, tmp_path):
    touch(tmp_path, *files.split())
    with pytest.raises(UsageError, match=said):
        find_pairs(tmp_path, tmp_path / "out")


def test_a_manifest(tmp_path):
    touch(tmp_path, "one.csv", "two.csv", "deep/three.mkv", "s.json")
    manifest = tmp_path / "m.csv"
    manifest.write_text(
        "﻿name,a,b,skeletons_a,person_b\nwalk, one.csv,two.csv,,7\n\nrun,deep/three.mkv,two.csv,s.json,\n",
        encoding="utf-8",
    )
    assert read_manifest(manifest) == [
        Pair("walk", tmp_path / "one.csv", tmp_path / "two.csv", person_b="7"),
        Pair("run", tmp_path / "deep/three.mkv", tmp_path / "two.csv", tmp_path / "s.json"),
    ]


@pytest.mark.parametrize(
    ("tracker", "option", "name"),
    [("blazepose", "tracker_model", "networks"), ("k4abt", "k4abt", "libk4abt.so")],
)
def test_workers_in_another_folder_find_the_files_of_the_options(
    tracker, option, name, tmp_path, monkeypatch
):
    touch(tmp_path, "pairs/a.mkv", "pairs/b.mkv", "networks/full", "elsewhere/x", "libk4abt.so")
    (tmp_path / "k.json").write_text(calibration_to_json(nominal_calibration(AZURE_KINECT)))
    seen = []

    def run(jobs, _):
        monkeypatch.chdir(tmp_path / "elsewhere")
        seen.extend(jobs)
        yield Outcome("pairs", None, "not fused")

    monkeypatch.setattr(processes, "run_in_processes", run)
    monkeypatch.chdir(tmp_path)
    files = "--calibrate", "k.json", "--tracker", tracker, f"--{option.replace('_', '-')}", name
    assert duplex("batch", "pairs", "--out", "out", *files) == 1
    options, identity = seen[0].options, seen[0].identity()["options"]
    assert (options.source, options.out) == (tmp_path / "pairs", tmp_path / "out")
    assert getattr(options, option) == tmp_path / name
    assert options.calibrate == str(tmp_path / "k.json")
    assert identity["calibrate"] == f"sha256:{checksum(tmp_path / 'k.json')}"
    (tmp_path / "k.json").unlink()  # as if the worker did not see this folder
    with pytest.raises(UsageError, match=r"k\.json"):
        seen[0].identity()


COUNTS = {f"{what}_{side}": 0 for what in ("dropped", "alone", "stale") for side in "ab"}


def row(name, state="fused", error="", **figures):
    job = Job(Pair(name, Path("a.csv"), Path("b.csv")), BatchOptions(source=Path(), out=Path()))
    known = dict.fromkeys(n for n in RANKED if n != "lost") | COUNTS | {"frames_a": 50, "frames_b": 50}
    record = {
        "figures": known | {"calibration": "pose <1>", "verdict": "good"} | figures,
        "warnings": ["<b>"],
        "identity": {},
    }
    return Row(job, state, record if state == "fused" else None, error)


def order(*rows):
    return [of.job.name for of in worst_first(rows)]


def test_failed_rows_come_first_then_the_worst_then_pending_ones():
    assert order(
        row("calm", views_agree=0.03, jumps_fused=0.0),
        row("left", "pending"),
        row("wild", views_agree=0.09, jumps_fused=0.2),
        row("lost", "failed", "no frames"),
        row("fair", views_agree=0.06, jumps_fused=0.1),
    ) == ["lost", "wild", "fair", "calm", "left"]


def test_frames_without_a_partner_count():
    one, two = row("one", dropped_a=20, alone_b=5), row("two")
    assert one.figures["lost"] == 0.25
    assert order(two, one) == ["one", "two"]


def test_the_table_is_in_si_units_and_the_page_escapes(tmp_path):
    rows = [row("bad", "failed", "a < b"), row("a b", views_agree=0.0625), row("rest", "pending")]
    write_parquet(rows, tmp_path / "s.parquet")
    table = pq.read_table(tmp_path / "s.parquet").to_pydict()
    assert table["name"] == ["bad", "a b", "rest"]
    assert table["views_agree"] == [None, 0.0625, None]
    assert table["session"] == [None, "a b/a b.rrd", None]
    write_page(rows, tmp_path / "s.html")
    page = (tmp_path / "s.html").read_text(encoding="utf-8")
    for words in ("a &lt; b", 'href="a%20b/a%20b.rrd"', "<td>62</td>", "pose &lt;1&gt;", "1 not fused yet"):
        assert words in page
    assert "<b>" not in page


def test_the_page_sorts_filters_and_explains(tmp_path):
    random = np.random.default_rng(0)
    rows, words = [], ("good", "usable", "poor", "unknown")
    for k, apart in enumerate([None, *random.permutation(12) * 0.011]):
        told = {"verdict": words[k % 4], "verdict_reason": f"reason {k}" if k % 4 else ""}
        rows.append(row(f"n{k}", views_agree=apart, bone_error=0.0, good=k / 12, **told))
    write_page(rows, tmp_path / "s.html")
    with browser() as context:
        tab = context.new_page()
        errors, asked = [], []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.on("request", lambda request: asked.append(request.url))
        tab.goto((tmp_path / "s.html").as_uri())
        shown, heads = tab.locator("#fused tbody tr:visible"), tab.locator("#fused th")
        names = heads.all_inner_texts()
        agree = names.index("views agree mm")

        def column(k):
            return [each.split("\t")[k].strip() for each in shown.all_inner_texts()]

        for turn in (1, -1):
            heads.nth(agree).click()
            *known, last = column(agree)
            assert last == "–"
            assert [int(each) for each in known] == sorted(map(int, known))[::turn]
        heads.nth(1).click()
        order = [each.split()[0] for each in column(1)]
        assert order == sorted(order, key=("poor", "unknown", "usable", "good").index)
        tab.locator("#word").select_option("poor")
        assert {each.split()[0] for each in column(1)} == {"poor"}
        assert tab.locator("#count").inner_text() == f"{shown.count()} of 13"
        tab.locator("#word").select_option("")
        tab.locator("#filter").fill("REASON 11")
        assert column(0) == ["n11"]
        meanings = tab.locator("details dt").all_text_contents()
        assert meanings == names[2:]
        assert (errors, asked) == ([], [(tmp_path / "s.html").as_uri()])
