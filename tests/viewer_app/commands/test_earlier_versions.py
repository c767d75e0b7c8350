"""Sessions of versions 0.1 and 1.0 open and replay as documented; real pairs give the results of 0.1."""

import hashlib
import lzma
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from recordings.session import Session
from tests.helpers.command_line import duplex
from tests.helpers.programs import python

DATA = Path(__file__).parents[2] / "data"

THE_METHOD_OF_0_1 = ("--method", "paper")
"""The options of ``duplex fuse`` that choose what version 0.1 did."""


@dataclass(frozen=True)
class Saved:
    """The contents of a session as the version that wrote it read them; the digests are SHA-256."""

    body: str
    frames: int
    fused: str
    events: tuple[str, ...]
    depth_images: int = 0
    depth: str = hashlib.sha256(b"").hexdigest()


SESSIONS = {
    "version_0_1/demo": Saved(
        "azure_kinect",
        24,
        "53353ea178fba666fa88f91be25891eb5313ae913e25a51b618b3322ec311188",
        ("calibrated: provisional, 1 frames of any pose",),
    ),
    "version_0_1/fused": Saved(
        "kinect_v2",
        25,
        "4abdddf3a57044c766c3dececcc10cd0b95c2a6b1ffa9e7e8fb2096729509cf8",
        ("calibrated: start-up pose at 0.0 s, 91 frames",),
    ),
    "version_0_1/live": Saved(
        "kinect_v1",
        36,
        "c892b21cd02d5962cedfe7f9dd18334151201d45772303881a7542eb0b34b27f",
        ("calibrated: known truth", "calibrated: known truth, moved by 20 mm"),
        6,
        "9bc023088aa63d814b256b60f9d6f2ae3369c17e53454339d5d410ef19fe3e69",
    ),
    "version_0_1/published": Saved(
        "kinect_v2",
        20,
        "33d8d049eaffc089004a16e8522984531cb4f85a28e6b1b26f1842106a537b12",
        ("calibrated: known truth",),
    ),
    "version_1_0/walk": Saved(
        "kinect_v1",
        19,
        "07e1e4397c49f91cb7be55bf73417a386bf72f6c3ee6d668da1f1bd41921422b",
        ("calibrated: known truth",),
    ),
}


@pytest.fixture(params=SESSIONS)
def saved(request, tmp_path):
    path = tmp_path / "session.rrd"
    path.write_bytes(lzma.decompress((DATA / f"{request.param}.rrd.xz").read_bytes()))
    return path, SESSIONS[request.param]


def test_a_session_reads_as_its_version_read_it(saved):
    path, expected = saved
    session = Session.open(path)
    assert session.damage is None
    assert (session.body.name, len(session)) == (expected.body, expected.frames)
    assert tuple(event.text for event in session.events) == expected.events
    assert digest(np.asarray(session.fused, dtype=np.float32)) == expected.fused
    images = [image for side in ("a", "b") for _, image in session.depth(side)]
    assert len(images) == 2 * expected.depth_images
    assert hashlib.sha256(b"".join(image.tobytes() for image in images)).hexdigest() == expected.depth


def test_a_session_replays_bit_for_bit_unless_its_method_has_changed(saved, capsys):
    path, expected = saved
    changed = Session.open(path).settings.method == "duplex"
    assert duplex("replay", path, "--verify", "--no-viewer") == (1 if changed else 0)
    said = " ".join(capsys.readouterr().out.split())
    assert ("The method duplex has changed since this session was made" in said) == changed
    assert (f"S* of all {expected.frames} frames is the recorded one, bit for bit" in said) != changed


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
