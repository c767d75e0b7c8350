"""A comparison with motion capture on one self-contained HTML page."""

import numpy as np
from markupsafe import Markup

from fusion.movement.angles import ANGLES
from recordings.comparing.truth_comparison import SKELETONS, TruthComparison
from recordings.quality.figures import Figures
from recordings.session import Session
from viewer_app.report.pages.review_page import page_colors, page_template
from viewer_app.report.pages.truth_figures import (
    AGREEMENT_HEAD,
    ALL_HEAD,
    ANGLE_HEAD,
    JOINT_HEAD,
    NAMES,
    STEP_HEAD,
    agreement_rows,
    all_rows,
    angle_rows,
    joint_rows,
    step_line,
    step_rows,
    truth_lines,
)
from viewer_app.report.svg_plots import bar_plot, line_plot


def truth_page(session: Session, comparison: TruthComparison, figures: Figures) -> str:
    """The page as HTML."""
    return page_template("truth_page.html").render(
        name=session.name,
        truth=comparison.truth_name,
        frames=len(comparison),
        all_frames=len(session),
        names_table=comparison.table,
        unit=comparison.unit,
        colors=page_colors(),
        lines=list(truth_lines(figures)),
        all_head=ALL_HEAD,
        every=list(all_rows(figures)),
        time_plot=_time_plot(comparison),
        joint_plot=_joint_plot(figures),
        joint_head=JOINT_HEAD,
        joints=list(joint_rows(figures)),
        angle_plots=_angle_plots(comparison, figures),
        angle_head=ANGLE_HEAD,
        angles=list(angle_rows(figures)),
        agreement_head=AGREEMENT_HEAD,
        agreement=list(agreement_rows(figures)),
        step_head=STEP_HEAD,
        steps=list(step_rows(figures)),
        step_line=step_line(figures),
    )


def _time_plot(comparison: TruthComparison) -> Markup:
    lines = {
        name: (1e3 * comparison.mean_distance(key), key) for name, key in zip(NAMES, SKELETONS, strict=True)
    }
    return Markup(line_plot("mean distance to the truth", "mm", comparison.time_ns * 1e-9, lines, wide=True))


def _joint_plot(figures: Figures) -> Markup:
    names = list(figures["joints"])
    bars = {
        name: (np.array([figures["joints"][joint][key]["mean_mm"] for joint in names], dtype=float), key)
        for name, key in zip(NAMES, SKELETONS, strict=True)
    }
    return Markup(bar_plot("mm", names, bars))


def _angle_plots(comparison: TruthComparison, figures: Figures) -> Markup:
    time = comparison.time_ns * 1e-9
    found, true = comparison.angles["fused"]
    plots = []
    for k, name in enumerate(ANGLES):
        if name in figures["angles"]:
            lines = {"S*": (found[:, k], "fused"), "truth": (true[:, k], "truth")}
            plots.append(line_plot(name.replace("_", " "), "°", time, lines))
    return Markup("").join(map(Markup, plots))
