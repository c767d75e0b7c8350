"""A folder for OpenSim: S* as .trc and .mot, markers of its joints, set-ups of Scale and Inverse Kinematics.

The model is Pose2Sim's full-body one after Rajagopal et al. (2016), which the user puts into the folder.
Markers are at its joint centres, but those of knees and shoulders are in one vertical plane with the hips,
so that who stands upright has angles of 0°. Two hip markers do not show how the pelvis tilts, so the lumbar
joint is to be straight, as in the .mot, where markers show no other. A straight limb does not show its axial
rotation, and bends by 10° where the model's stiff trunk puts its hip 3 mm aside: hips, knees and elbows are
to be as in the .mot besides.
"""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from recordings.export import FILES
from recordings.export.even_frames import EvenPositions
from recordings.export.markers import write_trc
from recordings.export.opensim import write_mot
from recordings.gait import SIDES
from recordings.session_series import SessionSeries

MODEL = "Model_Pose2Sim_simple.osim"
_PLACES = {
    "hip": ("pelvis", -0.0707, -0.0661, 0.0835),
    "knee": ("femur_{0}", 0.0, -0.40796, -0.00275),
    "ankle": ("tibia_{0}", 0.0, -0.43, 0.0),
    "shoulder": ("torso", 0.02996, 0.3715, 0.17),
    "elbow": ("humerus_{0}", 0.013144, -0.286273, -0.009595),
    "wrist": ("radius_{0}", -0.008797, -0.235841, 0.01361),
}
"""Of a joint: a body of the model, and the right one's place on it, metres forward, up and to the right."""
_SCALED = (
    ("hip left", "hip right", "Z", "pelvis sacrum"),
    ("shoulder left", "shoulder right", "Z", "torso"),
    ("hip {0}", "shoulder {0}", "X Y", "pelvis sacrum torso"),
    ("hip {0}", "knee {0}", "X Y Z", "femur_{1}"),
    ("knee {0}", "ankle {0}", "X Y Z", "tibia_{1} talus_{1} calcn_{1} toes_{1}"),
    ("shoulder {0}", "elbow {0}", "X Y Z", "humerus_{1}"),
    ("elbow {0}", "wrist {0}", "X Y Z", "ulna_{1} radius_{1} hand_{1}"),
)
"""The ends of a length, and the axes and bodies that it scales."""
_STRAIGHT = {"L5_S1_Flex_Ext": 0.01, "L5_S1_Lat_Bending": 1e-3, "L5_S1_axial_rotation": 1e-3}
_OF_MOT = {
    **dict.fromkeys(("hip_flexion", "hip_adduction"), 3e-3),
    **dict.fromkeys(("knee_angle", "elbow_flex"), 6e-3),
    "hip_rotation": 3e-4,
    "arm_rot": 1e-4,
}
"""Coordinates that are to be 0, or of each side those of the .mot, and the weight of a radian where that of a
metre of a marker is 1: by hand, on a real and three simulated walks and squats."""


def write_folder(session: SessionSeries, *files: Path, rate: float | None = None) -> str:
    """Writes :data:`.export.FILES`, S* at an even rate, that of the recording if None.

    A joint that was never seen has no marker. The set-ups are for the longest time without a gap, because
    OpenSim stops at one.

    Raises:
        RecordingError: No frame has an S*.
    """
    trc, mot, markers, scale, ik = files
    write_trc(session, trc, rate)
    said, body = write_mot(session, mot, rate), session.body
    labels, placed = {}, ""
    for name, (part, x, y, z) in _PLACES.items():
        for side in SIDES:
            joint = body.joint(f"{name} {side}")
            if not session.rows.never_seen[joint]:
                label = labels[f"{name} {side}"] = body.joints[joint]
                frame = f"<socket_parent_frame>/bodyset/{part.format(side[0])}</socket_parent_frame>"
                place = f"<location>{x} {y} {-z if side == 'left' else z}</location>"
                placed += f'<Marker name="{label}">{frame}{place}</Marker>'
    tasks = "".join(
        f'<IKMarkerTask name="{label}"><weight>1</weight></IKMarkerTask>' for label in labels.values()
    )
    columns = mot.read_text(encoding="utf-8").split("\n")[6].split("\t")
    wanted = [(name, "default_value", weight) for name, weight in _STRAIGHT.items()]
    wanted += [(name, "from_file", _OF_MOT[name[:-2]]) for name in columns if name[:-2] in _OF_MOT]
    tasks += "".join(
        f'<IKCoordinateTask name="{name}"><weight>{weight:g}</weight><value_type>{value}</value_type>'
        "</IKCoordinateTask>"
        for name, value, weight in wanted
    )
    time_range = _longest(session, rate)
    documents = (
        f'<MarkerSet name="markers"><objects>{placed}</objects></MarkerSet>',
        f'<ScaleTool name="fused"><GenericModelMaker><model_file>{MODEL}</model_file>'
        f"<marker_set_file>{FILES[2]}</marker_set_file></GenericModelMaker>"
        "<ModelScaler><scaling_order>measurements</scaling_order>"
        f"<MeasurementSet><objects>{_measurements(labels)}</objects></MeasurementSet>"
        f"<marker_file>{FILES[0]}</marker_file><time_range>{time_range}</time_range>"
        "<preserve_mass_distribution>true</preserve_mass_distribution>"
        "<output_model_file>scaled.osim</output_model_file></ModelScaler>"
        "<MarkerPlacer><apply>false</apply></MarkerPlacer></ScaleTool>",
        '<InverseKinematicsTool name="fused"><model_file>scaled.osim</model_file>'
        f"<IKTaskSet><objects>{tasks}</objects></IKTaskSet>"
        f"<marker_file>{FILES[0]}</marker_file><coordinate_file>{FILES[1]}</coordinate_file>"
        f"<time_range>{time_range}</time_range><report_errors>true</report_errors>"
        "<output_motion_file>inverse_kinematics.mot</output_motion_file></InverseKinematicsTool>",
    )
    for path, content in zip((markers, scale, ik), documents, strict=True):
        root = ElementTree.fromstring(f'<OpenSimDocument Version="40000">{content}</OpenSimDocument>')
        ElementTree.indent(root, "\t")
        ElementTree.ElementTree(root).write(path, encoding="utf-8", xml_declaration=True)
    first, last = map(float, time_range.split())
    return f"{said}; set-ups for {MODEL}, from {first:.1f} to {last:.1f} s"


def _measurements(labels: dict[str, str]) -> str:
    """What scales the model, as XML, by the labels of the joints that have markers."""
    pairs: dict[tuple[str, str], set[str]] = {}  # of axes and bodies; both sides scale a trunk
    for *ends, axes, bodies in _SCALED:
        for side in SIDES:
            markers = [labels.get(end.format(side), "") for end in ends]
            if all(markers):
                pairs.setdefault((axes, bodies.format(side, side[0])), set()).add(" ".join(markers))
    found = ""
    for (axes, bodies), measured in pairs.items():
        ends = [f"<MarkerPair><markers>{pair}</markers></MarkerPair>" for pair in sorted(measured)]
        scales = [f'<BodyScale name="{body}"><axes>{axes}</axes></BodyScale>' for body in bodies.split()]
        found += (
            f'<Measurement name="{bodies.split()[0]} {axes}"><apply>true</apply>'
            f"<MarkerPairSet><objects>{''.join(ends)}</objects></MarkerPairSet>"
            f"<BodyScaleSet><objects>{''.join(scales)}</objects></BodyScaleSet></Measurement>"
        )
    return found


def _longest(session: SessionSeries, rate: float | None) -> str:
    """The first and last second of the longest time without a gap."""
    even = EvenPositions(session, rate)
    known = np.concatenate([[False], *(part[2] for part in even.parts()), [False]]).astype(int)
    begins, ends = np.flatnonzero(np.diff(known) == 1), np.flatnonzero(np.diff(known) == -1)
    longest = int(np.argmax(ends - begins))
    return " ".join(f"{1e-9 * even.time_ns[k]:.6f}" for k in (begins[longest], ends[longest] - 1))
