"""Two fusions of one capture on one self-contained HTML page."""

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from recordings.comparing.session_comparison import Comparison
from recordings.quality.figures import report
from recordings.session import Session
from viewer_app.report.pages.comparison_figures import (
    BONES_HEAD,
    JOINTS_HEAD,
    bone_rows,
    distance_rows,
    lead,
    moments,
    other_settings,
)
from viewer_app.report.pages.good_part import good_seconds
from viewer_app.report.pages.review_page import page_colors, page_template, recorded, stretches
from viewer_app.report.svg_plots import line_plot
from viewer_app.report.words import lead_lines


def comparison_page(
    sessions: Sequence[Session], comparison: Comparison, worst: Sequence[tuple[int, int]]
) -> str:
    """The page as HTML.

    Args:
        worst: Frames and joints of the moments to list.
    """
    told = [{line.label: line for line in lead_lines(report(each))} for each in sessions]
    labels = list(dict.fromkeys(label for lines in told for label in lines))
    known = np.isfinite(comparison.apart).any(axis=1)
    median, most = np.full((2, len(comparison)), np.nan)
    median[known] = 1e3 * np.nanmedian(comparison.apart[known], axis=1)
    most[known] = 1e3 * np.nanmax(comparison.apart[known], axis=1)
    lines = {"median joint": (median, "fused"), "largest": (most, "truth")}
    time = comparison.first.time_ns * 1e-9
    return page_template("comparison_page.html").render(
        names=[each.name for each in sessions],
        recorded=[recorded(each) for each in sessions],
        frames=len(comparison),
        settings=list(other_settings(sessions)),
        lines=list(lead(comparison)),
        strips=[(stretches(each), good_seconds(each)) for each in sessions],
        rows=[[label, *(lines[label].text if label in lines else "–" for lines in told)] for label in labels],
        moments=[(f"{when:.2f} s", words) for when, words in moments(comparison, worst)],
        plot=Markup(line_plot("distance of the two S*", "mm", time, lines, wide=True)),
        joint_head=JOINTS_HEAD,
        joints=list(distance_rows(comparison)),
        bone_head=BONES_HEAD,
        bones=list(bone_rows(comparison)),
        colors=page_colors(),
    )
