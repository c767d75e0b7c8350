"""``rerun-importer-duplex``, called as a Rerun viewer calls it."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fusion.body import AZURE_KINECT, BLAZEPOSE, BODIES, KINECT_V1, KINECT_V2, Body
from recordings import layout
from recordings.reading.rrd_file import RrdFile, damage_of, read_columns
from recordings.writing import sensor_log
from tests.helpers.mkv_writer import write_mkv
from tests.helpers.pictures import headless_viewer, picture_of, pixels_near
from tests.helpers.session_text import rows_of
from tests.helpers.skeleton_views import write_view
from tests.helpers.two_views import moving, standing
from tests.helpers.waiting import eventually
from viewer_app.importer import NOT_MINE, is_mine, main

_CALLED_WITH = (  # by Rerun 0.41, and a flag of a later version
    *("--application-id", "app", "--recording-id", "rec-1"),
    *("--opened-application-id", "other", "--opened-recording-id", "rec-0"),
    *("--time_duration_nanos", "sim=5", "--time_sequence", "step=3", "--of_a_later_version", "7"),
)
_PERSON = "sensor/people/0"
Imported = Callable[..., Path]
_PROGRAM = Path(sys.executable).with_name("rerun-importer-duplex")


def called(path: Path) -> subprocess.CompletedProcess[bytes]:
    """Runs the installed program; the test is skipped where only the source is there."""
    if not _PROGRAM.exists():
        pytest.skip("rerun-importer-duplex is not installed beside this Python")
    return subprocess.run([_PROGRAM, path, *_CALLED_WITH], capture_output=True, timeout=120)


def positions_of(rrd: Path, entity: str = f"/{_PERSON}") -> NDArray[np.float32]:
    """(T, J, 3) of a person in a recording that was written."""
    found = read_columns(rrd, lambda each: each == entity)
    assert found.damage is None
    return np.asarray(found.values[entity, "Points3D:positions"][1])


def words_of(rrd: Path, entity: str) -> str:
    """All names and texts that an entity has, images left out."""
    with RrdFile(rrd) as file:
        batches = [batch for each, batch in file.chunks(images=True) if each == entity]
    columns = [(name, batch.column(name)) for batch in batches for name in batch.schema.names]
    return " ".join(f"{name} {column.to_pylist() if 'blob' not in name else ''}" for name, column in columns)


@pytest.fixture
def imported(tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]) -> Imported:
    """A function that imports a file in this process and returns the recording that was written."""

    def run(path: Path, *more: str) -> Path:
        assert main([str(path), *more]) == 0
        said = capfdbinary.readouterr()
        assert said.err == b""
        rrd = tmp_path / f"{path.name}.rrd"
        rrd.write_bytes(said.out)
        assert damage_of(rrd) is None
        return rrd

    return run


def as_json(path: Path, body: Body, positions: NDArray[np.float64]) -> Path:
    """An offline_processor file, with its keys in the order of that program."""
    frames = [
        {
            "bodies": [{"body_id": 0, "joint_positions": (1e3 * at).tolist()}],
            "frame_id": t,
            "num_bodies": 1,
            "timestamp_usec": 33_333 * t,
        }
        for t, at in enumerate(positions)
    ]
    document = {"bone_list": [["A", "B"]] * 40, "frames": frames, "joint_names": list(body.joints)}
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def as_ntu(path: Path, positions: NDArray[np.float64]) -> Path:
    """An NTU RGB+D file; its camera space has x to the left and y up."""
    lines = [str(len(positions))]
    for at in positions:
        lines += ["1", "0 0 1 1 1 1 0 0.1 0.2 2", str(len(at))]
        lines += [f"{-x:.6f} {-y:.6f} {z:.6f} 0 0 0 0 0 0 0 0 2" for x, y, z in at]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_program_writes_a_recording_with_the_ids_that_the_viewer_gives(tmp_path: Path) -> None:
    truth = moving(KINECT_V2, 40)
    done = called(write_view(tmp_path / "walk.csv", KINECT_V2, truth))
    assert (done.returncode, done.stderr) == (0, b"")
    rrd = tmp_path / "out.rrd"
    rrd.write_bytes(done.stdout)
    assert damage_of(rrd) is None
    np.testing.assert_allclose(positions_of(rrd), truth, rtol=0, atol=1e-6)  # the file is to the micrometre
    for name in (b"app", b"rec-1"):
        assert name in done.stdout
    for name in (b"other", b"rec-0"):
        assert name not in done.stdout


def test_the_program_leaves_a_foreign_file_to_others(tmp_path: Path) -> None:
    path = tmp_path / "prices.csv"
    path.write_text("date,price\n2026-01-01,3\n")
    done = called(path)
    assert (done.returncode, done.stdout, done.stderr) == (NOT_MINE, b"", b"")


@pytest.mark.parametrize("body", [KINECT_V1, AZURE_KINECT, BLAZEPOSE], ids=str)
def test_each_body_is_shown(body: Body, tmp_path: Path, imported: Imported) -> None:
    truth = np.repeat(standing(body)[None], 3, axis=0)
    rrd = imported(write_view(tmp_path / "a.csv", body, truth))
    np.testing.assert_allclose(positions_of(rrd), truth, rtol=0, atol=1e-6)
    assert body.joints[-1] in words_of(rrd, "/sensor"), "the viewer names the joints"


def test_json_and_skeleton_files_are_shown_too(tmp_path: Path, imported: Imported) -> None:
    truth = moving(KINECT_V2, 4)
    for path in (as_json(tmp_path / "a.json", KINECT_V2, truth), as_ntu(tmp_path / "a.skeleton", truth)):
        np.testing.assert_allclose(positions_of(imported(path)), truth, rtol=0, atol=1e-6)


def test_people_come_and_go_and_inferred_joints_have_another_colour(
    tmp_path: Path, imported: Imported, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sensor_log, "_BLOCK", 2)  # one person leaves in the first block for good
    path = write_view(tmp_path / "a.csv", KINECT_V1, np.repeat(standing(KINECT_V1)[None], 4, axis=0))
    header, *rows = path.read_text().splitlines()
    each = len(KINECT_V1)
    rows[0] = rows[0].replace("tracked", "inferred")
    rows[each : 2 * each] = [row.replace(",0,", ",7,", 1) for row in rows[each : 2 * each]]
    path.write_text("\n".join([header, *rows]) + "\n")
    rrd = imported(path)
    seen = {name: np.isfinite(positions_of(rrd, f"/sensor/people/{name}")).all(axis=(1, 2)) for name in "07"}
    assert seen["0"].tolist() == [True, False, True, True]
    assert seen["7"].tolist() == [False, True, False, False]
    colors = read_columns(rrd, lambda entity: entity == f"/{_PERSON}").values[
        f"/{_PERSON}", "Points3D:colors"
    ][1]
    amber = layout.STATE_COLORS[1]
    assert colors[0, 0] == int.from_bytes(bytes((*amber, 255)), "big")
    assert len(np.unique(colors)) == 2


def test_an_mkv_has_depth_images_and_a_camera(tmp_path: Path, imported: Imported) -> None:
    rrd = imported(write_mkv(tmp_path / "a.mkv", 3, color=True))
    assert rows_of(rrd, "/sensor/depth") == 3
    assert rows_of(rrd, "/sensor/color") == 3
    assert "application/rvl" in words_of(rrd, "/sensor/depth")
    assert "image_from_camera" in words_of(rrd, "/sensor/depth")


def test_everything_is_placed_below_the_prefix_that_is_asked_for(tmp_path: Path, imported: Imported) -> None:
    path = write_view(tmp_path / "a.csv", KINECT_V2, moving(KINECT_V2, 3))
    rrd = imported(path, "--entity-path-prefix", "lab/left")
    assert positions_of(rrd, f"/lab/left/{_PERSON}").shape == (3, 25, 3)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.csv", b""),
        ("a.csv", b"\xff\xfe\x00"),
        ("a.csv", b"time_us,body,joint,x,y\n"),
        ("a.json", b'{"frames": [1, 2]}'),
        ("a.json", b'[{"frames": 2, "timestamp_usec": 1}]'),
        ("a.json", b""),
        ("a.skeleton", b"[Serializer_v1.40]"),
        ("a.skeleton", b"3\n1\n0 0\n25\n1 2 3\n"),
        ("a.skeleton", b""),
        ("a.mkv", b"\x1a\x45\xdf\xa3 a film"),
        ("a.mkv", b""),
        ("a.rrd", b"time_us,body,joint,x,y,z\n"),
        ("a", b"time_us,body,joint,x,y,z\n"),
    ],
)
def test_foreign_files_are_known_by_their_first_bytes(name: str, content: bytes, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert not is_mine(path)
    assert main([str(path)]) == NOT_MINE


@pytest.mark.parametrize("name", ["A.CSV", "a.csv"])
def test_a_byte_order_mark_and_capitals_are_no_hindrance(name: str, tmp_path: Path) -> None:
    path = tmp_path / name
    path.write_bytes(b"\xef\xbb\xbftime_us, body, joint, x, y, z\n")
    assert is_mine(path)


def test_a_foreign_file_costs_no_import_of_rerun(tmp_path: Path) -> None:
    """A viewer asks for every file that it opens."""
    path = tmp_path / "a.csv"
    path.write_text("date,price\n")
    told = "import sys; from viewer_app.importer import main; code = main(sys.argv[1:]);"
    told += "print(code, sorted({'numpy', 'rerun', 'pyarrow', 'fusion', 'devices'} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", told, path], capture_output=True, text=True, check=True)
    assert done.stdout == f"{NOT_MINE} []\n"


@pytest.mark.parametrize("kind", ["csv", "json", "skeleton", "mkv"])
def test_a_damaged_file_gives_one_line_and_no_recording(
    kind: str, tmp_path: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    truth = moving(KINECT_V2, 3)
    path = tmp_path / f"a.{kind}"
    if kind == "csv":
        write_view(path, KINECT_V2, truth)
    elif kind == "json":
        as_json(path, KINECT_V2, truth)
    elif kind == "skeleton":
        as_ntu(path, truth)
    else:
        write_mkv(path, 1, calibration=b'{"CalibrationInformation": {}}')
    whole = path.read_bytes()
    path.write_bytes(whole if kind == "mkv" else whole[: len(whole) * 2 // 3])
    assert main([str(path)]) == 1
    said = capfdbinary.readouterr()
    assert said.out == b""
    assert said.err.startswith(b"rerun-importer-duplex: ")
    assert said.err.count(b"\n") == 1


def test_an_mkv_that_is_cut_off_is_shown_as_far_as_it_goes(tmp_path: Path, imported: Imported) -> None:
    path = write_mkv(tmp_path / "a.mkv", 6)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    rrd = imported(path)
    assert 0 < rows_of(rrd, "/sensor/depth") < 6
    assert "is cut off" in words_of(rrd, "/sensor/events")


def test_a_reader_that_goes_away_ends_the_program(tmp_path: Path) -> None:
    """A viewer may be closed while it loads."""
    if not _PROGRAM.exists():
        pytest.skip("rerun-importer-duplex is not installed beside this Python")
    path = write_view(tmp_path / "a.csv", KINECT_V2, moving(KINECT_V2, 300))
    process = subprocess.Popen([_PROGRAM, path], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    assert process.stdout is not None
    process.stdout.read(16)
    process.stdout.close()
    process.wait(60)


def test_a_viewer_shows_a_csv_that_it_opens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if not _PROGRAM.exists():
        pytest.skip("rerun-importer-duplex is not installed beside this Python")
    monkeypatch.setenv("PATH", f"{_PROGRAM.parent}{os.pathsep}{os.environ['PATH']}")
    path = write_view(tmp_path / "walk.csv", KINECT_V2, moving(KINECT_V2, 300))
    with headless_viewer(str(path)) as viewer:
        color = layout.SKELETON_COLORS["a"]
        picture = tmp_path / "w.png"
        # joints and bones of a person who is half as high as the scene cover thousands of pixels
        assert eventually(lambda: pixels_near(picture_of(viewer, picture), color, 40) > 1000, 60.0, 0.3)
        state = viewer.get_state()
        assert [report for view in state.views for report in view.reports] == []
        assert {view.name for view in state.views} == {"in the sensor's frame", "as the depth camera sees it"}


def test_every_known_body_is_covered() -> None:
    assert set(BODIES.values()) == {KINECT_V1, KINECT_V2, AZURE_KINECT, BLAZEPOSE}
