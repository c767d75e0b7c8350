"""Exports in OpenSim's own library: they load whole, and its tools scale a model and follow the markers."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fusion.body import KINECT_V2
from tests.helpers.machine import lacks
from tests.helpers.motion_capture import captured
from tests.helpers.opensim_model import LEGS, write_legs
from tests.helpers.uneven import uneven


@pytest.fixture(scope="module")
def opensim():
    try:
        import opensim
    except ImportError:
        lacks("opensim", "pip install opensim")
    opensim.Logger.setLevelString("Off")
    return opensim


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    return captured(tmp_path_factory.mktemp("walk") / "s.rrd", KINECT_V2, "walk", 8.0, seed=3).session


def rows_of(path):
    """The table of a .mot as text."""
    return path.read_text().split("endheader\n")[1].splitlines()[1:]


@given(data=st.data())
def test_opensim_loads_every_session_whole(data, opensim, walk, tmp_path_factory):
    folder = tmp_path_factory.mktemp("s")
    session = uneven(walk, data.draw)
    session.export(folder / "s.trc")
    session.export(folder / "s.mot")
    markers = opensim.TimeSeriesTableVec3(str(folder / "s.trc"))
    assert markers.getNumRows() == len((folder / "s.trc").read_text().splitlines()) - 6
    assert list(markers.getColumnLabels()) == list(session.body.joints)
    wanted = len(rows_of(folder / "s.mot"))
    assert opensim.TimeSeriesTable(str(folder / "s.mot")).getNumRows() == wanted
    assert opensim.Storage(str(folder / "s.mot")).getSize() == wanted  # reads up to the first nan


def test_scale_and_inverse_kinematics(opensim, walk, tmp_path, monkeypatch):
    """The recipe of docs/animation.md, on legs: pelvis, thighs and shins, not as long as the person's."""
    monkeypatch.chdir(tmp_path)
    walk.export("walk.trc")
    walk.export("walk.mot")
    write_legs(opensim, "legs.osim")
    times = opensim.ArrayDouble(0.0, 2)
    times.set(1, float(walk.time[-1]))

    scale = opensim.ScaleTool()
    scale.setSubjectMass(70.0)
    scale.getGenericModelMaker().setModelFileName("legs.osim")
    scaler = scale.getModelScaler()
    scaler.setMarkerFileName("walk.trc")
    scaler.setTimeRange(times)
    scaler.setScalingOrder(words(opensim, "measurements"))
    for body, (begin, end) in LEGS.items():
        measurement = opensim.Measurement()
        measurement.setName(body)
        measurement.setApply(True)
        measurement.getMarkerPairSet().cloneAndAppend(opensim.MarkerPair(begin, end))
        along = opensim.BodyScale()
        along.setName(body)
        along.setAxisNames(words(opensim, "X", "Y", "Z"))
        measurement.getBodyScaleSet().cloneAndAppend(along)
        scaler.addMeasurement(measurement)
    scaler.setOutputModelFileName("scaled.osim")
    scale.getMarkerPlacer().setApply(False)
    scale.run()  # false, because no markers are placed
    assert Path("scaled.osim").exists()

    inverse = opensim.InverseKinematicsTool()
    inverse.set_model_file("scaled.osim")
    inverse.setMarkerDataFileName("walk.trc")
    inverse.setStartTime(times.get(0))
    inverse.setEndTime(times.get(1))
    inverse.setOutputMotionFileName("found.mot")
    inverse.set_report_errors(True)
    assert inverse.run()
    errors = opensim.TimeSeriesTable("_ik_marker_errors.sto")
    rms = errors.getDependentColumn("marker_error_RMS").to_numpy()
    found = opensim.TimeSeriesTable("found.mot").getDependentColumn("knee_l").to_numpy()
    sent = opensim.TimeSeriesTable("walk.mot").getDependentColumn("knee_angle_l").to_numpy()
    # Bones of S* have constant lengths, so that legs fit but for the distance of the hips, which varies by
    # some millimetres. Turning a thigh of 0.4 m by 5 mm is less than a degree.
    assert np.median(rms) < 0.005
    assert np.median(np.abs(-found - sent)) < 1.0  # the knee of this model is extended by positive angles


def words(opensim, *each):
    """OpenSim's array of strings."""
    array = opensim.ArrayStr()
    for word in each:
        array.append(word)
    return array
