"""``duplex compare`` with motion capture: what it prints and writes, and its one line where it cannot."""

import json

import numpy as np
import pytest

from fusion.body import KINECT_V2
from fusion.movement.angles import ANGLES, joint_angles
from recordings.data import layout
from recordings.session import Session
from tests.helpers.command_line import duplex, one_line
from tests.helpers.motion_capture import captured, true_positions, write_c3d, write_trc
from tests.helpers.sentences import check_sentences, refusals
from tests.helpers.session_text import rows_of

# of laboratories, on the joints of KINECT_V2
MARKERS = {
    "LSHO": "ShoulderLeft", "LELB": "ElbowLeft", "LWRA": "WristLeft", "LWRB": "WristLeft",
    "RSHO": "ShoulderRight", "RELB": "ElbowRight", "RWRA": "WristRight", "RWRB": "WristRight",
    "LASI": "HipLeft", "LPSI": "HipLeft", "LKNE": "KneeLeft", "LANK": "AnkleLeft",
    "RASI": "HipRight", "RPSI": "HipRight", "RKNE": "KneeRight", "RANK": "AnkleRight",
}  # fmt: skip


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    folder = tmp_path_factory.mktemp("walk")
    seen = captured(folder / "walk.rrd", KINECT_V2, "walk", 14.0, seed=13)
    times, points = seen.truth(3.7, 10.0, missing=0.1)
    chosen = points[:, [KINECT_V2.joint(joint) for joint in MARKERS.values()]]
    write_c3d(folder / "walk.c3d", [f"Ann:{name}" for name in MARKERS], times, chosen)
    write_trc(folder / "lab.trc", [f"m{j}" for j in range(len(KINECT_V2))], times, points)
    return folder


def test_s_in_k_a_s_frame_and_after_the_fit_stand_side_by_side(walk, tmp_path, capsys):
    session, true = Session.open(walk / "walk.rrd"), true_positions(KINECT_V2, "walk")
    times = np.arange(1000) / 100.0
    write_trc(tmp_path / "a.trc", list(KINECT_V2.joints), times, true(times))
    report = tmp_path / "c.json"
    how = ("--no-viewer", "--report", report, "--offset", 0)
    assert duplex("compare", walk / "walk.rrd", tmp_path / "a.trc", *how) == 0
    said, figures = " ".join(capsys.readouterr().out.split()), json.loads(report.read_text())
    within = session.time <= times[-1]
    off = np.nanmean(np.linalg.norm((session.fused - true(session.time))[within], axis=2))
    assert figures["as_filed_mm"] == pytest.approx(1e3 * off, rel=0.01)
    fitted = figures["all_joints"]["fused"]["mean_mm"]
    assert fitted < figures["as_filed_mm"]
    assert (
        f"{figures['as_filed_mm']:.0f} mm off (mean) in K_A's frame, which the file has; {fitted:.0f} mm"
        in said
    )
    assert duplex("compare", walk / "walk.rrd", walk / "walk.c3d", *how[:-2], "--force") == 0
    assert json.loads(report.read_text())["as_filed_mm"] is None
    assert "K_A's frame" not in capsys.readouterr().out


def test_markers_of_a_laboratory_are_compared_without_a_table(walk, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    page, report, scene = (tmp_path / name for name in ("c.html", "c.json", "c.rrd"))
    outputs = ("--html", page, "--report", report, "--save", scene)
    assert duplex("compare", walk / "walk.rrd", walk / "walk.c3d", "--no-viewer", "--verbose", *outputs) == 0
    said = capsys.readouterr().out
    assert "frames compared: 13 joints by the table plug-in-gait, in millimetres." in said
    for words in ("Offset ", "mean over joints and frames", "knee flexion left", "AnkleRight"):
        assert words in said
    figures = json.loads(report.read_text())
    assert figures["offset_s"] == pytest.approx(3.7, abs=2.5e-3 * figures["offset_sd_ms"])
    assert figures["offset_sd_ms"] < 5.0
    assert 0.8 < figures["correlation"] < 1.0
    assert 0.0 < figures["residual_mm"] < 120.0
    assert f"correlate at {figures['correlation']:.2f}; {figures['residual_mm']:.0f} mm (median)" in said
    every = figures["all_joints"]
    assert every["fused"]["mean_mm"] < min(every["a"]["mean_mm"], every["b"]["mean_mm"])
    assert figures["joints"].keys() == {"SpineBase", *MARKERS.values()}
    for joint in figures["joints"].values():
        assert joint["fused"]["rest_mean_mm"] < joint["fused"]["mean_mm"] + 1.0
    session = Session.open(walk / "walk.rrd")
    seconds = session.time_ns * 1e-9
    angles = [
        joint_angles(KINECT_V2, at)[:, 0]
        for at in (session.fused, true_positions(KINECT_V2, "walk")(seconds))
    ]
    within = (seconds > 3.7) & (seconds < 13.7)
    off = (angles[0] - angles[1])[within]
    knee = figures["angles"][ANGLES[0]]["fused"]
    assert knee["rmse_deg"] == pytest.approx(np.sqrt(np.nanmean(off**2)), rel=0.1)  # a tenth is missing
    steps = figures["steps"]["of_each"]
    assert {"step time", "step length", "stance", "cadence", "speed"} <= steps.keys()
    for of in steps.values():
        assert of["count"] >= 5
    assert "step length, m" in said
    assert "steps of the truth were not found" in " ".join(said.split())
    text = page.read_text()
    assert "<h2>Steps</h2>" in text
    assert text.count("<svg") == 2 + len(figures["angles"])
    assert "walk.c3d" in text
    for entity in (layout.TRUTH_SKELETON, layout.FUSED_SKELETON, layout.skeleton("a"), layout.skeleton("b")):
        assert rows_of(scene, entity) == figures["frames"]


def test_names_of_ones_own_take_a_table(walk, tmp_path, capsys):
    table = tmp_path / "lab.toml"
    lines = [f'{name} = "m{KINECT_V2.joint(name)}"' for name in KINECT_V2.joints]
    table.write_text("\n".join(["[joints]", *lines]))
    files = walk / "walk.rrd", walk / "lab.trc", "--no-viewer"
    assert duplex("compare", *files, "--names", table) == 0
    assert "25 joints by the table" in capsys.readouterr().out.replace("\n", " ")
    assert duplex("compare", *files) == 2
    assert "0 of the joints of kinect_v2 are found" in one_line(capsys)
    table.write_text("\n".join(["[joints]", *lines[:-1], f'{KINECT_V2.joints[-1]} = "m99"']))
    assert duplex("compare", *files, "--names", table) == 2
    assert "'m99'; the file has m0, m1, m2" in one_line(capsys)


def test_an_offset_that_the_motion_contradicts_is_kept_with_a_warning(walk, capsys):
    warning = "The motion contradicts it: by the motion, the offset is 3.70"
    files = walk / "walk.rrd", walk / "walk.c3d", "--no-viewer"
    assert duplex("compare", *files, "--offset", "3.75") == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "3.7500 s to add to the truth's times, as given" in said
    assert warning in said
    assert duplex("compare", *files, "--offset", "3.705") == 0
    assert warning not in " ".join(capsys.readouterr().out.split())


def test_sentences_of_comparisons(walk, capsys, monkeypatch):
    monkeypatch.chdir(walk)
    check_sentences("compare", refusals(capsys, walk))
