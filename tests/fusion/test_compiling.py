"""Compiled kernels on disk, and their compilation on a first run."""

import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.compiling import disk_cache, first_run
from fusion.compiling.disk_cache import drop_stale_kernels
from fusion.compiling.first_run import FirstRun
from fusion.estimator import estimator
from fusion.facing import sequence
from fusion.facing.sequence import relabel_sequence, reported_pairs
from fusion.fuser import Fuser
from fusion.paper import method as paper
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup
from fusion.skeleton import SkeletonPair
from tests.helpers.programs import python

CALLED = """
from numba import njit

@njit(cache=True)
def answer():
    return {value}
"""
CALLER = """
from numba import njit
from {package}.called import answer

@njit(cache=True)
def ask():
    return answer()

print(ask())
"""
INIT = """
from pathlib import Path
from fusion.compiling.disk_cache import drop_stale_kernels
drop_stale_kernels(Path(__file__).parent)
"""


def ask(folder):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(Path.cwd())])}
    return subprocess.run(
        [sys.executable, "-m", "edited.caller"], capture_output=True, text=True, env=environment, check=True
    ).stdout.strip()


def test_a_kernel_follows_an_edit_of_what_it_calls(tmp_path):
    """The edit changes the size too: Python compares a source's size and its time in whole seconds."""
    package = tmp_path / "edited"
    package.mkdir()
    (package / "__init__.py").write_text(INIT)
    (package / "caller.py").write_text(CALLER.format(package="edited"))
    (package / "called.py").write_text(CALLED.format(value=1))
    assert ask(tmp_path) == "1"
    (package / "called.py").write_text(CALLED.format(value=22))
    assert ask(tmp_path) == "22"


def test_only_kernels_older_than_a_source_go(tmp_path):
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    for name, age in (("old.nbi", 1), ("new.nbi", 3), ("module.pyc", 1)):
        (cache / name).touch()
        os.utime(cache / name, ns=(age, age))
    (tmp_path / "source.py").touch()
    os.utime(tmp_path / "source.py", ns=(2, 2))
    drop_stale_kernels(tmp_path)
    assert sorted(path.name for path in cache.iterdir()) == ["module.pyc", "new.nbi"]
    imported = tmp_path / "imported"
    imported.mkdir()
    (imported / "constants.py").touch()
    os.utime(imported / "constants.py", ns=(4, 4))
    drop_stale_kernels(tmp_path, imported)
    assert sorted(path.name for path in cache.iterdir()) == ["module.pyc"], "they contain its constants"


UNWRITABLE = "import os, tempfile\n"
NOBODY = """
import os, pwd
del os.environ["HOME"], os.environ["XDG_CACHE_HOME"]
os.access = lambda *_: False  # nor may this user write into the installation
pwd.getpwuid = {}.__getitem__
"""
NOWHERE = """
import os, tempfile
def mkdtemp(**_): raise FileNotFoundError
tempfile.mkdtemp = mkdtemp
"""


@pytest.mark.parametrize(
    ("user", "kept"),
    [(UNWRITABLE, "True"), (NOBODY, "True"), (NOWHERE, "False")],
    ids=["home", "nobody", "tmp"],
)
def test_without_any_folder_to_write_kernels_are_kept_for_the_run(tmp_path, user, kept):
    """Files take the place of the folders, because permissions do not stop root."""
    if user is NOBODY and sys.platform == "win32":
        pytest.skip("every user of Windows has a home")
    for package in ("fusion", "devices", "recordings"):
        shutil.copytree(package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    for source in [*tmp_path.rglob("__init__.py")]:
        (source.parent / "__pycache__").touch()
    (tmp_path / "home").touch()
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    for name in ("HOME", "XDG_CACHE_HOME", "LOCALAPPDATA", "USERPROFILE"):
        environment[name] = str(tmp_path / "home")
    code = (
        "import devices.depth.rvl\n"
        "import devices.simulated.imaging.rendering, devices.simulated.tracking.errors\n"
        "import os, pathlib, numpy\n"
        "assert 'NUMBA_CACHE_DIR' not in os.environ\n"
        "devices.depth.rvl.encode_depth(numpy.zeros((1, 1), dtype=numpy.uint16))\n"
        "folder = pathlib.Path(os.environ.get('NUMBA_CACHE_DIR', 'nowhere'))\n"
        "print(devices.depth.rvl.__file__, folder.is_dir(), folder)"
    )
    run = subprocess.run(
        [sys.executable, "-c", user + code], cwd=tmp_path, capture_output=True, text=True, env=environment
    )
    assert run.returncode == 0, run.stderr
    source, there, folder = run.stdout.split()
    assert source.startswith(str(tmp_path))
    assert there == kept
    assert not Path(folder).exists()  # it is deleted with the process
    assert not (tmp_path / "~").exists()


@pytest.fixture
def kept_kernel(tmp_path, monkeypatch):
    """A function that runs a kernel anew; returns its result and how often it was found on disk."""
    (tmp_path / "kept.py").write_text(COLD)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr("numba.config.CACHE_DIR", str(tmp_path / "kernels"))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # Python does not notice a full disk

    def run():
        monkeypatch.delitem(sys.modules, "kept", raising=False)
        loop = import_module("kept").loop
        return loop(1), len(loop.stats.cache_hits)

    return run


@pytest.mark.parametrize("damage", ["cut", "empty", "not a file"])
def test_kernels_that_are_damaged_on_disk_are_compiled_again(tmp_path, kept_kernel, damage):
    kept_kernel()
    files = [path for path in (tmp_path / "kernels").rglob("*") if path.is_file()]
    assert len(files) == 4
    for file in files:
        content = file.read_bytes()
        file.unlink()
        if damage == "not a file":
            file.mkdir()
        else:
            file.write_bytes(content[: len(content) // 2 if damage == "cut" else 0])
    assert kept_kernel() == (3, 0)
    assert kept_kernel() == (3, 0 if damage == "not a file" else 1)


def test_a_kernel_in_the_file_of_other_types_is_compiled_again(tmp_path, kept_kernel):
    """numba leaves it there if two processes keep a kernel at once, and would run it."""
    kept_kernel()
    assert sys.modules["kept"].loop(1.5) == 4.0
    files = sorted((tmp_path / "kernels").rglob("kept.loop-*.nbc"))
    for file, other in list(zip(files, [file.read_bytes() for file in files[::-1]], strict=True)):
        file.write_bytes(other)
    assert kept_kernel() == (3, 0)
    assert sys.modules["kept"].loop(1.5) == 4.0
    assert kept_kernel() == (3, 1)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of file sizes")
def test_a_full_disk_costs_a_compilation(kept_kernel):
    """Beyond a limit of file sizes writing fails as on a full disk."""
    import resource

    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1][1]))
    try:
        assert [kept_kernel(), kept_kernel()] == [(3, 0), (3, 0)]
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before[1])
        signal.signal(signal.SIGXFSZ, before[0])
    assert [kept_kernel(), kept_kernel()] == [(3, 0), (3, 1)]


COLD = """
from pathlib import Path
from fusion.compiling.kernels import compiles
from fusion.compiling.kernels import kernel

@kernel
def solve(x):
    return 2 * x

@kernel
def loop(x):
    return solve(x) + 1

@compiles(loop)
def compile_loop():
    loop(1)
    with Path(__file__).with_name("misses").open("a") as file:
        file.write(f"{len(loop.stats.cache_misses)} ")

@compiles(solve)
def compile_solver():
    solve(1)

@compiles(solve)
def never_ends():
    import time
    Path(__file__).with_name("begun").touch()
    time.sleep(600)
"""


def test_a_kernel_on_disk_is_called_without_what_compiling_needs(tmp_path):
    (tmp_path / "cold.py").write_text(COLD)
    program = "import cold, sys; print(cold.loop(1), 'numba.np.linalg' in sys.modules, cold.loop(1.5))"
    said = [python("-c", program, PYTHONPATH=f"{tmp_path}{os.pathsep}{Path.cwd()}").stdout for _ in range(2)]
    assert said == ["3 True 4.0\n", "3 False 4.0\n"]


@pytest.fixture
def cold(tmp_path, monkeypatch):
    """A module with two kernels that are not on disk."""
    (tmp_path / "cold.py").write_text(COLD)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delitem(sys.modules, "cold", raising=False)
    return import_module("cold")


def found(*kernels):
    """How often each was found on disk, and how often it was compiled here."""
    return [
        sum(each.values())
        for kernel in kernels
        for each in (kernel.stats.cache_hits, kernel.stats.cache_misses)
    ]


def test_a_first_run_compiles_in_other_processes(cold):
    with FirstRun([cold.compile_loop], [cold.compile_solver]) as run:
        assert run.progress()[:2] == (0, 2)
        run.finish()
    assert run.progress() == (2, 2, 0.0)
    assert cold.loop(1) == 3
    assert found(cold.loop) == [1, 0], "loaded"
    assert (Path(cold.__file__).with_name("misses")).read_text() == "1 0 ", "compiled by the other process"


def test_a_later_run_starts_no_process_and_loads(cold, monkeypatch):
    cold.loop(1)
    monkeypatch.setattr(first_run, "_start", lambda _: pytest.fail("a process"))
    with FirstRun([cold.compile_loop], [cold.compile_solver]) as run:
        run.finish(load=False)
        assert not Path(cold.__file__).with_name("misses").exists()
        run.finish()
        assert Path(cold.__file__).with_name("misses").exists()


@pytest.mark.parametrize("missing", ["cache", "process"])
def test_without_a_cache_or_a_process_the_program_compiles(cold, missing, monkeypatch):
    if missing == "cache":
        monkeypatch.setattr(disk_cache, "_prepare_disk", lambda _: False)
    else:
        monkeypatch.setattr(sys, "executable", "/nonexistent")
    with FirstRun([cold.compile_loop], [cold.compile_solver]) as run:
        run.finish(load=False)
    assert run.progress() == (2, 2, 0.0)
    assert cold.loop.signatures


def test_ctrl_c_ends_a_first_run_and_its_processes(cold):
    begun = Path(cold.__file__).with_name("begun")

    def interrupt():
        while not begun.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)  # unlike raise_signal, it reaches the main thread

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt), FirstRun([cold.never_ends]) as run:
        run.finish()
    assert [process.returncode is not None for process in run._processes] == [True]


@given(
    seconds=st.lists(st.floats(0.0, 100.0), min_size=5, max_size=5), data=st.data(), every=st.floats(0.1, 3.0)
)
def test_the_progress_never_sinks_and_is_told_at_least_every_five_seconds(seconds, data, every):
    compiled, now, told, kernels = set(), [0.0], [], list("abcdefgh")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            first_run, "_add_calls", lambda _, calls: calls.update({each: set() for each in kernels})
        )
        patch.setattr(first_run, "_cost", lambda *_: 1.5)
        patch.setattr(first_run, "_is_compiled", compiled.__contains__)
        run = FirstRun(
            [Mock(dispatchers=[None])], tell=lambda progress: told.append((now[0], progress)), every=every
        )
        run._clock, run._began = lambda: now[0], 0.0

        def wait(pause):
            now[0] += pause
            compiled.update(data.draw(st.sets(st.sampled_from(kernels), max_size=3)))
            return now[0] > 20.0

        run._finished = Mock(wait=wait)
        run._tell_often()
        for later in seconds:
            now[0] += later
            run._tell(run.progress())
        compiled.update(kernels)
        run._tell(run.progress())
    times, progress = zip(*told, strict=True)
    assert max(np.diff([0.0, *times[: -len(seconds) - 1]])) <= 5.0
    assert [each.done for each in progress] == sorted(each.done for each in progress)
    assert all(0 <= each.done <= each.of == len(kernels) and each.seconds_left >= 0.0 for each in progress)
    assert progress[-1] == (len(kernels), len(kernels), 0.0)


@pytest.mark.parametrize(
    ("method", "module", "kernel"),
    [
        ("duplex", estimator, "estimate_pairs"),
        ("paper", paper, "fuse_frames"),
        ("published", paper, "fuse_frames_as_published"),
    ],
)
def test_a_transposed_rotation_compiles_nothing_anew(method, module, kernel):
    calibration = nominal_calibration(KINECT_V2)
    there = calibration.a_from_b
    counts = []
    for transform in (there, RigidTransform(np.asfortranarray(there.rotation), there.translation)):
        setup = FusionSetup(replace(calibration, a_from_b=transform), FuserSettings(method=method))
        Fuser(setup).update(SkeletonPair(None, None, 0))
        counts.append(len(getattr(module, kernel).signatures))
    assert counts[0] == counts[1] > 0


def test_one_place_of_a_sensor_compiles_what_a_place_for_each_pair_does():
    at, states = np.zeros((3, len(KINECT_V2), 3)), np.full((3, len(KINECT_V2)), 2, np.uint8)
    counts = []
    for sensor in (np.ones((3, 3)), np.ones(3)):
        pairs = reported_pairs((at, at), (states, states), sensor)
        relabel_sequence(KINECT_V2, pairs, np.arange(3) * 33_000_000)
        counts.append(len(sequence._forward.signatures))
    assert counts[0] == counts[1] > 0
