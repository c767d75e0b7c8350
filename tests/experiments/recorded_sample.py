"""Writes the session that the viewer shows while a first run compiles its kernels.

``python -m tests.experiments.recorded_sample`` writes ``viewer_app/viewer/recorded_sample.rrd``.
"""

import numpy as np
import rerun.blueprint as rrb

from recordings.appearance.coach_page import CoachPage, large
from recordings.data import layout
from recordings.file.session_writer import write_session
from recordings.testing import simulated_session
from viewer_app.sinks.live_session import SAMPLE
from viewer_app.viewer import blueprint

TEXT = "**Recorded sample.** The live demo takes its place as soon as its kernels are compiled."
BEGIN, END = 3.0, 6.5  # seconds, of a walk: the start-up pose is over


def write(path=SAMPLE):
    """Writes the sample: S_A, S_B and S* of a person who walks, without images."""
    session = simulated_session("walk", seconds=END, seed=1)
    frames = np.flatnonzero((session.time >= BEGIN) & (session.time < END))
    sample = session.part(frames)
    write_session(sample, path, blueprint=looping(sample), page=CoachPage(large(TEXT), from_start=True))


def looping(session):
    """A layout with one scene, in which the viewer plays the session again and again."""
    setup, person_at = session.last_setup, session.whereabouts
    eye = blueprint._AWAY * blueprint._towards_eye(setup, person_at) - np.array([0.0, blueprint._ABOVE, 0.0])
    hidden = [f"{layout.COACH}/**"]
    scene = blueprint._scene(
        person_at + eye,
        person_at,
        f"recorded sample. {blueprint.SCENE}",
        setup.body,
        0.2,
        hidden,
        follow=True,
    )
    text = rrb.TextDocumentView(origin=layout.COACH, contents=[layout.COACH], name="first run")
    return rrb.Blueprint(
        rrb.Vertical(text, scene, row_shares=[1, 6]),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME, play_state="playing", loop_mode="all"),
        auto_views=False,
    )


if __name__ == "__main__":
    write()
