"""``duplex`` replays what version 0.1 saved, and computes what version 0.1 computed, bit for bit."""

from __future__ import annotations

import hashlib
import lzma
import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from recordings.session import Session
from tests.helpers.command_line import duplex

THE_METHOD_OF_0_1: tuple[str, ...] = ()
"""The options of ``duplex fuse`` that choose what version 0.1 did."""


SESSIONS = sorted((Path(__file__).parents[1] / "data" / "sessions_v0_1").glob("*.rrd.xz"))


@pytest.mark.parametrize("compressed", SESSIONS, ids=lambda path: path.name.partition(".")[0])
def test_the_command_replays_a_session_of_0_1_bit_for_bit(
    compressed: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / compressed.stem
    session.write_bytes(lzma.decompress(compressed.read_bytes()))
    assert duplex("replay", session, "--verify", "--no-viewer") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert f"S* of all {len(Session.open(session))} frames is the recorded one, bit for bit" in said


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


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64"), reason="the digests are of x86-64 processors"
)
@pytest.mark.parametrize("name", REAL_PAIRS)
def test_a_real_pair_gives_the_fused_skeleton_of_0_1_to_the_bit(
    name: str, shared: Path, tmp_path: Path
) -> None:
    folder, file = shared / "real" / f"kinect_v2_90deg_{name}", tmp_path / "s.rrd"
    recordings = [str(folder / "a.csv"), str(folder / "b.csv")]
    options = ["--no-viewer", "--save", str(file), *THE_METHOD_OF_0_1]
    # The last bits of the calibration's SVD depend on the processor, for which OpenBLAS chooses a kernel.
    # The digests are of the kernel that every x86-64 processor can run.
    subprocess.run(
        [sys.executable, "-m", "viewer_app.cli", "fuse", *recordings, *options],
        check=True,
        capture_output=True,
        env={**os.environ, "OPENBLAS_CORETYPE": "Prescott"},
    )
    session = Session.open(file)
    as_float32, checksums = REAL_PAIRS[name]
    assert digest(np.asarray(session.fused, dtype=np.float32)) == as_float32
    assert digest(session.fused_checksums) == checksums


def digest(values: np.ndarray) -> str:
    """SHA-256 of an array's bytes."""
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()
