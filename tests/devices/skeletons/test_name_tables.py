"""Tables of names: what they find in labels as laboratories write them, and wrong ones."""

import pytest

from devices.sensor import DeviceError
from devices.skeletons.name_tables import READY_MADE, fitting_table, name_table
from fusion.body import AZURE_KINECT, BODIES, KINECT_V1, KINECT_V2

PLUG_IN_GAIT = """
    LFHD RFHD LBHD RBHD C7 T10 CLAV STRN LSHO LELB LWRA LWRB LFIN RSHO RELB RWRA RWRB RFIN
    LASI RASI LPSI RPSI LTHI LKNE LTIB LANK LHEE LTOE RTHI RKNE RTIB RANK RHEE RTOE
""".split()  # noqa: SIM905
GAIT2392 = """
    Sternum R.Acromium L.Acromium Top.Head R.ASIS L.ASIS V.Sacral R.Thigh.Upper R.Knee.Lat R.Knee.Med
    R.Ankle.Lat R.Ankle.Med R.Heel R.Toe.Tip L.Thigh.Upper L.Knee.Lat L.Knee.Med L.Ankle.Lat L.Ankle.Med
    L.Heel L.Toe.Tip
""".split()  # noqa: SIM905
MIXAMO = """
    Hips Spine Spine1 Spine2 Neck Head LeftShoulder LeftArm LeftForeArm LeftHand RightArm RightForeArm
    RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg RightFoot RightToeBase
""".split()  # noqa: SIM905


@pytest.mark.parametrize(
    ("table", "labels", "joints"),
    [
        ("plug-in-gait", [f"Subject:{name}" for name in PLUG_IN_GAIT], {"WRIST_LEFT": ["LWRA", "LWRB"]}),
        ("plug-in-gait", [*PLUG_IN_GAIT, "LFEO"], {"KNEE_LEFT": ["LFEO"], "KNEE_RIGHT": ["RKNE"]}),
        ("gait2392", [name.lower() for name in GAIT2392], {"KNEE_LEFT": ["L.Knee.Lat", "L.Knee.Med"]}),
        ("mixamo", [f"mixamorig:{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["LeftArm"]}),
        ("mixamo", [f"mixamorig{name}" for name in MIXAMO], {"SHOULDER_LEFT": ["mixamorigLeftArm"]}),
        ("mixamo", [f"mixamorig1_{name}" for name in MIXAMO], {"HEAD": ["mixamorig1_Head"]}),
        ("bodies", KINECT_V2.joints, {"PELVIS": ["SpineBase"], "ELBOW_LEFT": ["ElbowLeft"]}),
    ],
)
def test_the_table_of_a_file_is_found_by_its_labels(table, labels, joints):
    found = fitting_table(AZURE_KINECT, labels)
    assert found.name == table
    points = found.points_of(AZURE_KINECT, labels)
    for joint, names in joints.items():
        short = [labels[k].rpartition(":")[2].lower() for k in points[AZURE_KINECT.joint(joint)]]
        assert short == [name.lower() for name in names]
    lateral = {"hip", "knee", "ankle", "shoulder"}
    assert {f"{part} {side}" for part in lateral for side in ("left", "right")} <= {
        AZURE_KINECT.joints[j].lower().replace("_", " ") for j in points
    }


@pytest.mark.parametrize("table", READY_MADE)
@pytest.mark.parametrize("body", BODIES.values(), ids=str)
def test_left_and_right_of_a_ready_made_table_are_mirror_images(table, body):
    names = name_table(table).joints
    labels = sorted({point for ways in names.values() for way in ways for point in way})
    found = name_table(table).points_of(body, labels)
    assert len(found) > 0
    for joint, own in found.items():
        other = found[int(body.mirror[joint])]
        if body.mirror[joint] != joint:
            assert own != other
            mine, others = ([labels[k].strip("LRefight.") for k in points] for points in (own, other))
            assert mine == others


def test_a_table_of_ones_own_weighs_points_and_takes_the_first_whole_alternative(tmp_path):
    path = tmp_path / "lab.toml"
    lines = '"hip left" = ["A", "A", "B"]', 'WristLeft = [["C", "D"], ["c"]]', 'EYE_LEFT = "E"'
    path.write_text("\n".join(["[joints]", *lines]))
    points = name_table(path).points_of(KINECT_V1, ["Head", "B", "C", "Bob:A"])
    assert points == {
        KINECT_V1.joint("HipLeft"): [3, 3, 1],
        KINECT_V1.joint("WristLeft"): [2],
        KINECT_V1.joint("Head"): [0],
    }


def test_of_two_subjects_a_table_names_one():
    labels = [f"{subject}:{name}" for subject in ("Ann", "Bob") for name in PLUG_IN_GAIT]
    assert fitting_table(AZURE_KINECT, labels).points_of(AZURE_KINECT, labels) == {}
    assert name_table("plug-in-gait").points_of(AZURE_KINECT, labels) == {}


def test_a_missing_table_is_named_with_the_ready_made_ones():
    with pytest.raises(DeviceError, match=r"No table of names 'vicon'.*plug-in-gait, gait2392, mixamo"):
        name_table("vicon")
