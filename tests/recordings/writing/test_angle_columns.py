"""Joint angles for the viewer's plots: those of a session, with their variance, and what no joint reaches."""

import numpy as np
import pytest

from fusion.movement.angles import ANGLES
from recordings.data import layout
from recordings.file.rrd_file import read_columns
from recordings.quality.limits import PLOTTED_DEGREES, POSSIBLE
from recordings.session import Session
from tests.helpers.live_frames import frames, known_fuser, session


@pytest.fixture(scope="module")
def fuser_and_frames():
    fuser = known_fuser()
    return fuser, frames(fuser, 20)


@pytest.mark.parametrize("reached", [True, False])
def test_the_plots_have_the_sessions_angles(fuser_and_frames, tmp_path, monkeypatch, reached):
    if not reached:
        monkeypatch.setitem(POSSIBLE, "elbow_flexion", (1000.0, 1001.0))
        monkeypatch.setitem(PLOTTED_DEGREES, "elbow_flexion", (100.0, 200.0))
    fuser, made = fuser_and_frames
    with session(fuser, tmp_path / "s.rrd") as live:
        for frame in made:
            live.write(frame)
    angles = Session.open(tmp_path / "s.rrd").angles
    found = read_columns(tmp_path / "s.rrd", lambda entity: entity.startswith(layout.ANGLES)).values
    for component, expected in ((layout.DEGREES, angles.degrees), (layout.VARIANCES, angles.sigma**2)):
        for k, name in enumerate(ANGLES):
            numbers, values = found[layout.ANGLES, f"{component}.{name}"]
            np.testing.assert_allclose(values[:, 0], expected[numbers, k], rtol=1e-3, atol=1e-2)
    marked = found.get((layout.ANGLES_BEYOND, f"{layout.DEGREES}.elbow_flexion_left"))
    assert (marked is None) == reached
    if marked is not None:
        numbers, values = marked
        assert numbers.tolist() == list(range(0, 20, 2))
        assert ((values > 100.0) & (values < 110.0)).all()  # on the screen, at the edge nearest to the angle
        _, others = found[layout.ANGLES_BEYOND, f"{layout.DEGREES}.knee_flexion_left"]
        assert np.isnan(others).all()
