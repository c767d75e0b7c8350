"""Sessions that version 0.1 wrote open, and replay bit for bit.

``duplex demo --seconds 1 --depth none`` made the one of the Azure Kinect, which has two calibrations and the
truth. ``recordings.testing.record_fused`` made the others: one with depth images, frames without a person and
frames of A alone, one by the published solver with equal weights.
"""

from __future__ import annotations

import lzma
from pathlib import Path

import numpy as np
import pytest

from fusion.fuser import Fuser
from recordings.session import Session
from recordings.writing.checksums import fused_checksums

OLD = sorted((Path(__file__).parent.parent / "data" / "sessions_v0_1").glob("*.rrd.xz"))
DEPTH_FRAMES = {"kinect_v1_images_gaps": [0, 5, 10, 15]}


@pytest.fixture(params=OLD, ids=lambda path: path.name.partition(".")[0])
def old(request: pytest.FixtureRequest, tmp_path: Path) -> Session:
    path = tmp_path / request.param.stem
    path.write_bytes(lzma.decompress(request.param.read_bytes()))
    return Session.open(path)


def test_there_are_three() -> None:
    assert len(OLD) == 3


def test_an_old_session_is_whole(old: Session) -> None:
    assert old.damage is None
    assert old.frames_lost == 0
    assert len(old) == (30 if old.path.stem == "azure_kinect_live_truth" else 20)
    assert (old.rows.truth is not None) == (old.path.stem == "azure_kinect_live_truth")
    assert [frame for frame, _ in old.depth("a")] == DEPTH_FRAMES.get(old.path.stem, [])


def test_an_old_session_replays_bit_for_bit(old: Session) -> None:
    pairs = [pair.skeletons for pair in old.pairs()]
    setups = old.setups()
    fused = [f.positions for setup, own in setups for f in Fuser(setup).fuse_sequence(pairs[own])]
    np.testing.assert_array_equal(fused_checksums(np.array(fused)), old.fused_checksums)
