"""Saved sessions open as recorded and replay as documented; real pairs give the results of 0.1."""

import hashlib
import platform

import numpy as np
import pytest

from fusion.setup import REVISIONS
from recordings.session import Session
from tests.helpers import golden_session, saved_sessions
from tests.helpers.command_line import duplex
from tests.helpers.programs import python

THE_METHOD_OF_0_1 = ("--method", "paper")
"""The options of ``duplex fuse`` that choose what version 0.1 did."""


@pytest.fixture(params=saved_sessions.names())
def saved(request, tmp_path):
    """The file of a session, and what its version read in it."""
    path = saved_sessions.unpacked(request.param, tmp_path / "session.rrd")
    return path, saved_sessions.readings()[request.param]


def test_a_session_reads_as_its_version_read_it(saved):
    path, expected = saved
    assert saved_sessions.reading(Session.open(path)) == expected


@pytest.mark.parametrize("later", [0, 1], ids=["today", "a later revision"])
def test_a_session_replays_bit_for_bit_unless_its_method_has_changed(saved, capsys, monkeypatch, later):
    """A later revision of ``duplex`` that gives the same S* stands for every other one."""
    path, expected = saved
    method, revision, today = expected["method"], expected["revision"], dict(REVISIONS)
    monkeypatch.setitem(REVISIONS, "duplex", REVISIONS["duplex"] + later)
    status = duplex("replay", path, "--verify", "--no-viewer")
    said = " ".join(capsys.readouterr().out.split())
    assert (f"The method {method} has changed since this session" in said) == (revision != REVISIONS[method])
    if revision == today[method]:
        if method == "duplex" and not golden_session.c_library_rounds_likewise():
            pytest.skip("S* of duplex was recorded on Linux on an x86-64 processor with FMA")
        assert f"S* of all {expected['frames']} frames is the recorded one, bit for bit" in said
        assert status == 0


REAL_PAIRS = {
    "stationary": (
        "caba6c367270a850f82dff5730a983d8dace8c85f1aa83d49b2cb266972dd7fb",
        "a2ca8b9ab99f33b8fb5996d4fa9a4f8fe48559e6415e94ab2ac133da4fb08a12",
    ),
    "steps": (
        "c169fa0ea911545595789d1bae2a92cd966762080512636a80b3b4424296c116",
        "61587c512f7e37c11eb892f77b6f5dec9a3fd59420898b28bfb6383d239663ce",
    ),
    "walk": (
        "cccce858b7acfb649cf74772fcca37fad001a4ac1d961dcc0a566b76fbe3d1e4",
        "f9c6c9665120b4bba95c16c2ca95b22808dacf8d78b9461c7c5a02d1c9dc937c",
    ),
}
"""SHA-256 of version 0.1's S*: of the float32 joints in the file, and of the float64 joints' checksums."""


FUSES = """
import sys
from viewer_app.cli import main
for argument in sys.argv[1:]:
    main(argument.split("\\n"))
"""


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"), reason="the digests are of x86-64 processors"
)
def test_the_real_pairs_give_the_fused_skeletons_of_0_1_to_the_bit(shared, tmp_path):
    commands = []
    for name in REAL_PAIRS:
        pair = [shared / "real" / f"kinect_v2_90deg_{name}" / side for side in ("a.csv", "b.csv")]
        options = "--no-viewer", "--save", tmp_path / f"{name}.rrd", *THE_METHOD_OF_0_1
        commands.append("\n".join(map(str, ("fuse", *pair, *options))))
    # The last bits of the calibration's SVD depend on the processor, for which OpenBLAS chooses a kernel.
    # The digests are of the kernel that every x86-64 processor can run.
    done = python("-c", FUSES, *commands, OPENBLAS_CORETYPE="Prescott")
    assert done.returncode == 0, done.stderr
    for name, digests in REAL_PAIRS.items():
        session = Session.open(tmp_path / f"{name}.rrd")
        found = digest(np.asarray(session.fused, dtype=np.float32)), digest(session.fused_checksums)
        assert found == digests, name


def digest(values):
    """SHA-256 of an array's bytes."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
