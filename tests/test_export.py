"""Each format read back by a library that is not ours."""

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion.body import BODIES, KINECT_V2, Body
from recordings.errors import RecordingError
from recordings.export import writer_for
from recordings.export.even_frames import even_frames
from recordings.session import Session
from recordings.testing import record_fused
from tests.frame_pairs import calibration_of, frame_pairs

GAP = (20, 21, 22)


@pytest.fixture(params=BODIES.values(), ids=str)
def session(request: pytest.FixtureRequest, tmp_path: Path) -> Session:
    """A moving person, whom no sensor sees in three frames; timestamps jitter by up to 3 ms."""
    body: Body = request.param
    pairs = frame_pairs(body, 60, gap=GAP, jitter_ns=3_000_000)
    return record_fused(tmp_path / "s.rrd", pairs, calibration_of(body))


def y_up(positions: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([positions[..., 0], -positions[..., 1], -positions[..., 2]], axis=-1)


def exported(session: Session, name: str, **how: str) -> Path:
    path = session.path.with_name(name)
    writer_for(path, **how)(session, path)
    return path


def test_long_csv_has_every_skeleton_in_k_a_s_frame(session: Session) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(exported(session, "s.csv"))
    rows, T, J = session.rows, len(session), len(session.body)
    for name, expected in (("a", rows.positions_a), ("b", rows.b_in_a), ("fused", rows.fused)):
        part = table[table.skeleton == name]
        assert part.joint.tolist()[:J] == list(session.body.joints)
        np.testing.assert_allclose(part[["x", "y", "z"]].to_numpy().reshape(T, J, 3), expected, atol=1e-9)
    np.testing.assert_allclose(part.time_s.to_numpy()[::J], rows.time_ns * 1e-9, atol=1e-9)
    assert table[(table.frame == GAP[0]) & (table.skeleton == "fused")].x.isna().all()


def test_wide_csv_has_a_row_a_frame(session: Session) -> None:
    pandas = pytest.importorskip("pandas")
    table = pandas.read_csv(exported(session, "s.csv", table="wide"))
    joint = session.body.joints[5]
    np.testing.assert_allclose(table[f"{joint}_y"].to_numpy(), session.rows.fused[:, 5, 1], atol=1e-9)
    assert len(table.columns) == 2 + 3 * len(session.body)


def test_parquet_has_the_same_rows_and_says_its_units(session: Session) -> None:
    pandas = pytest.importorskip("pandas")
    pyarrow_parquet = pytest.importorskip("pyarrow.parquet")
    path = exported(session, "s.parquet")
    table = pandas.read_parquet(path)
    fused = table[table.skeleton == "fused"][["x", "y", "z"]].to_numpy()
    np.testing.assert_array_equal(fused.reshape(session.rows.fused.shape), session.rows.fused)
    assert pyarrow_parquet.read_schema(path).metadata[b"units"] == b"metres, seconds"


def test_npz_has_every_array(session: Session) -> None:
    with np.load(exported(session, "s.npz")) as arrays:
        np.testing.assert_array_equal(arrays["fused"], session.rows.fused)
        np.testing.assert_array_equal(arrays["positions_b"], session.rows.positions_b)
        assert tuple(arrays["joints"]) == session.body.joints


def test_trc_is_in_millimetres_y_up_with_empty_cells_for_gaps(session: Session) -> None:
    pandas = pytest.importorskip("pandas")
    path = exported(session, "s.trc")
    lines = path.read_text(encoding="utf-8").split("\n")
    head = dict(zip(lines[1].split("\t"), lines[2].split("\t"), strict=True))
    assert (head["Units"], head["DataRate"], head["NumFrames"]) == ("mm", "30", "60")
    assert [name for name in lines[3].split("\t")[2:] if name] == list(session.body.joints)
    table = pandas.read_csv(path, sep="\t", skiprows=6, header=None, skip_blank_lines=False)
    at = table.iloc[:, 2:].to_numpy(dtype=float).reshape(session.rows.fused.shape)
    np.testing.assert_allclose(at, 1e3 * y_up(session.rows.fused), atol=1e-4)
    np.testing.assert_allclose(table[1], session.rows.time_ns * 1e-9, atol=1e-6)


def test_c3d_is_read_by_another_library(session: Session) -> None:
    pytest.importorskip("ezc3d")
    c3d = pytest.importorskip("c3d")
    path = exported(session, "s.c3d")
    even = even_frames(session.rows)
    with path.open("rb") as file:
        reader = c3d.Reader(file)
        assert reader.point_rate == 30.0
        assert reader.get("POINT").get("UNITS").string_value.strip() == "mm"
        assert [label.strip() for label in reader.point_labels] == list(session.body.joints)
        frames = [points for _, points, _ in reader.read_frames()]
    assert len(frames) == len(even.index)
    for points, index in zip(frames, even.index, strict=True):
        if index in GAP:
            assert (points[:, 3] == -1).all()
            continue
        x, y, z = 1e3 * session.rows.fused[index].T
        np.testing.assert_allclose(
            points[:, :3], np.stack([x, z, -y], axis=1), atol=1e-3
        )  # float32 of metres


def test_bvh_joints_reproduce_the_fused_ones_within_a_tenth_of_a_millimetre(session: Session) -> None:
    bvhio = pytest.importorskip("bvhio")
    path = exported(session, "s.bvh")
    even = even_frames(session.rows)
    body = session.body
    root = bvhio.readAsHierarchy(str(path))
    header = path.read_text(encoding="utf-8")
    assert f"Frames: {len(even.index)}\nFrame Time: 0.033333" in header
    for moment in (0, 15, GAP[1], 45, len(even.index) - 1):
        index = even.index[moment]
        index = GAP[0] - 1 if index in GAP else index  # the last pose is held
        root.loadPose(moment)
        at = {node.Name: np.array(node.PositionWorld) for node, _, _ in root.layout()}
        expected = 100.0 * y_up(session.rows.fused[index])
        for joint, position in zip(body.joints, expected, strict=True):
            np.testing.assert_allclose(at[joint], position, atol=0.01)  # cm


def test_a_pause_in_the_recording_is_a_gap_at_an_even_rate(tmp_path: Path) -> None:
    pairs = frame_pairs(KINECT_V2, 40)
    late = [p for k, p in enumerate(pairs) if not 10 <= k < 25]
    session = record_fused(tmp_path / "s.rrd", late, calibration_of(KINECT_V2))
    even = even_frames(session.rows)
    assert even.rate == 30.0
    assert (even.index[12:23] == -1).all()
    np.testing.assert_array_equal(even.index[:10], np.arange(10))
    np.testing.assert_array_equal(even.index[25:], np.arange(10, 25))


def test_an_unknown_ending_says_which_are_known(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"Known: \.bvh, \.c3d"):
        writer_for(tmp_path / "s.fbx")
