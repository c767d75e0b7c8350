"""The formats of recorded skeletons: what is read, and what a broken file says."""

import json
import re

import numpy as np
import pytest

from devices.sensor import DeviceError
from devices.skeletons.file_sensor import SkeletonRecording
from fusion.body import AZURE_KINECT, KINECT_V2
from tests.helpers.two_views import standing


def read(path):
    with SkeletonRecording(path) as recording:
        return recording.body, list(recording.frames())


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ("moment,body,joint,x,y,z\n0,0,Head,0,0,2\n", "no column time_us.*named frame that counts"),
        ("time_us,body,joint,x,y,z,x\n0,0,Head,0,0,2,0\n", "repeats a column name"),
        ("time_us,body,joint,x,y,z\n0,0,Tail,0,0,2\n", "Unknown joint 'Tail'"),
    ],
)
def test_a_broken_csv_says_what_is_wrong(tmp_path, broken, message):
    (tmp_path / "a.csv").write_text(broken, encoding="utf-8")
    with pytest.raises(DeviceError, match=message):
        read(tmp_path / "a.csv")


def offline_processor(body):
    person = {
        "body_id": 7,
        "joint_positions": (1000.0 * standing(body)).tolist(),
        "joint_orientations": [[1.0, 0.0, 0.0, 0.0]] * len(body),
    }
    each = [
        {"timestamp_usec": 33_333 * t, "frame_id": t, "num_bodies": int(t > 0), "bodies": [person] * (t > 0)}
        for t in range(3)
    ]
    about = {"k4abt_sdk_version": "1.1.2", "source_file": "own.mkv", "bone_list": []}
    return {**about, "joint_names": list(body.joints), "frames": each}


def test_offline_processor_json_is_read_in_metres(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(offline_processor(AZURE_KINECT)), encoding="utf-8")
    body, frames = read(path)
    assert body is AZURE_KINECT
    assert [frame.time_ns for frame in frames] == [0, 33_333_000, 66_666_000]
    assert frames[0].people == {}
    np.testing.assert_allclose(frames[1].people["7"].positions, standing(AZURE_KINECT), atol=1e-6)


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda text: text[: len(text) // 2], "not complete JSON"),
        (lambda text: "", "is empty"),
        (lambda text: "[]", "not as offline_processor"),
        (lambda text: "{}", "no 'joint_names'"),
        (lambda text: text.replace('"PELVIS"', '"TAIL"'), "Unknown joint 'TAIL'"),
        (lambda text: text.replace("33333,", '"soon",'), "frame 1"),
        (lambda text: text.replace('"joint_positions": [[', '"joint_positions": [["x", ', 1), "frame 1"),
        (lambda text: text.replace('"frames"', '"pictures"'), "no 'frames'"),
        (lambda text: text.replace('"SPINE_NAVEL"', '"PELVIS"'), "names a joint twice"),
    ],
)
def test_broken_json_says_what_is_wrong(tmp_path, break_it, message):
    path = tmp_path / "a.json"
    path.write_text(break_it(json.dumps(offline_processor(AZURE_KINECT))), encoding="utf-8")
    with pytest.raises(DeviceError, match=message):
        read(path)


def ntu():
    lines = ["2"]
    for _ in range(2):
        lines += ["1", "72057594037931101 0 1 1 1 1 0 0.02 0.01 2", "25"]
        for x, y, z in standing(KINECT_V2) * [-1.0, -1.0, 1.0]:
            lines.append(f"{x:.7f} {y:.7f} {z:.7f} 277.4 191.8 1036.1 519.1 -0.2 0.03 0.9 0.05 2")
    return lines


@pytest.mark.parametrize(
    ("break_it", "message"),
    [
        (lambda lines: [], "is empty"),
        (lambda lines: lines[:20], "cut off at line 21"),
        (lambda lines: [*lines[:9], lines[9][:30]], "12 numbers"),
        (lambda lines: ["many", *lines[1:]], "line 1: expected the number of frames; got .many."),
        (lambda lines: [*lines[:5], lines[5].replace("277.4", "left"), *lines[6:]], "line 6: expected 12"),
        (lambda lines: [*lines[:3], "20", *lines[4:]], "a body has 20 joints"),
    ],
)
def test_a_broken_ntu_file_says_what_is_wrong(tmp_path, break_it, message):
    path = tmp_path / "a.skeleton"
    path.write_text("\n".join(break_it(ntu())), encoding="utf-8")
    with pytest.raises(DeviceError, match=message):
        read(path)


def test_files_that_are_no_recordings_are_refused(tmp_path):
    with pytest.raises(DeviceError, match=r"\.txt is not a format") as refused:
        read(tmp_path / "none.txt")
    known = re.findall(r"\.\w+", str(refused.value).partition("Known: ")[2])
    assert known == [".csv", ".json", ".skeleton", ".mkv", ".bag", ".db3"]
    (tmp_path / "noise.json").write_bytes(bytes(range(256)))
    with pytest.raises(DeviceError, match="not text"):
        read(tmp_path / "noise.json")
