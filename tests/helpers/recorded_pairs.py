"""Recordings of one person that tests write, names of the real ones, and sessions compared bit for bit."""

import json

import numpy as np

from fusion.body import KINECT_V2
from recordings.session import Session
from tests.helpers.two_views import A_FROM_B, FRAME_NS, moving

REAL = ("stationary", "steps", "walk")
"""``real/kinect_v2_90deg_…`` in the folder of reference recordings."""

FRAMES = 75
"""Long enough for a start-up pose of 1.5 s."""


def write_view(path, body, positions, start_us=0, every_us=FRAME_NS / 1000):
    """Writes (T, J, 3) positions of one person as .csv, to the micrometre."""
    rows = ["time_us,body,joint,x,y,z,state"]
    for t, at in enumerate(positions):
        rows += [
            f"{start_us + int(t * every_us)},0,{joint},{x:.6f},{y:.6f},{z:.6f},tracked"
            for joint, (x, y, z) in zip(body.joints, at, strict=True)
        ]
    path.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return path


def write_json(path, at):
    """Writes (T, 25, 3) positions of a KINECT_V2 as Microsoft's offline_processor does."""
    frames = []
    for t, positions in enumerate((at * 1e3).tolist()):
        bodies = [{"body_id": 1, "joint_positions": positions}]
        frames.append({"timestamp_usec": t * FRAME_NS // 1000, "bodies": bodies})
    path.write_text(json.dumps({"joint_names": KINECT_V2.joints, "frames": frames}), encoding="utf-8")
    return path


def write_ntu(path, at):
    """Writes (T, 25, 3) positions of a KINECT_V2 as the .skeleton of NTU RGB+D."""
    lines = [str(len(at))]
    for positions in at:
        lines += ["1", "7 0 0 0 0 0 0 0 0 2", "25"]
        lines += [f"{-x:.5f} {-y:.5f} {z:.5f} 0 0 0 0 0 0 0 1 2" for x, y, z in positions]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def write_recordings(folder, noise_m=0.01):
    """Two noisy views of a person, ``a.csv`` and ``b.csv``."""
    rng = np.random.default_rng(0)
    truth = moving(KINECT_V2, 70)
    a = truth + rng.normal(0.0, noise_m, truth.shape)
    b = A_FROM_B.inverse().apply(truth) + rng.normal(0.0, noise_m, truth.shape)
    return write_view(folder / "a.csv", KINECT_V2, a), write_view(folder / "b.csv", KINECT_V2, b)


def write_pair(folder, a="a.csv", b="b.csv", seed=0):
    """Writes two views of a moving person, each with 10 mm of noise, into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    truth = moving(KINECT_V2, FRAMES, seed)
    for name, view in ((a, truth), (b, A_FROM_B.inverse().apply(truth))):
        write_view(folder / name, KINECT_V2, view + rng.normal(0, 0.01, truth.shape))
    return folder


def assert_same_session(one, other):
    """Compares two sessions: every figure of every frame but the time that fusion took, in bits."""
    first, second = Session.open(one), Session.open(other)
    for (name, _, values), (_, _, others) in zip(first.rows.figures(), second.rows.figures(), strict=True):
        if name != "fuse_ms":
            assert values.tobytes() == others.tobytes(), name
    assert first.fused_checksums.tobytes() == second.fused_checksums.tobytes()
    assert first.events == second.events
    assert first.settings == second.settings
    assert len(first.calibrations) == len(second.calibrations)
