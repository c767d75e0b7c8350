"""The viewer's page about a recorded session: its verdict, and the figures behind it."""

from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage, large
from recordings.quality.figures import Figures
from recordings.quality.verdict import verdict
from viewer_app.coach.scene import CoachScene
from viewer_app.coach.setup_coach import Situation
from viewer_app.report.words import lead_lines

_SHOWN = ("Verdict", "S*", "Views agree", "Doubtful", "Calibration", "Repaired")


def session_page(setup: FusionSetup, figures: Figures, about: str = "") -> CoachPage:
    """The page, which holds from the first frame on."""
    lines = [line for line in lead_lines(figures) if line.label in _SHOWN]
    text = "\n\n".join([*(f"**{line.label}:** {line.text}" for line in lines), about])
    situation = Situation(setup.calibration, final=True, held=0.0)
    angle = [each for each in verdict(figures).findings if each.rule == "angle"]
    marks = CoachScene(setup.body, setup.intrinsics).page(angle, situation).marks
    return CoachPage(large(text), marks, from_start=True)
