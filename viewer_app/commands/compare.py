"""``duplex compare``: compares a session with motion capture, or with another fusion of the same capture."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape

from devices.skeletons.name_tables import name_table
from recordings.appearance import entity_styles
from recordings.comparing.comparison_scene import (
    DIFFERENCE,
    LARGEST,
    MEANS,
    record_comparison,
    record_truth_comparison,
)
from recordings.comparing.session_comparison import Comparison
from recordings.comparing.truth_comparison import TruthComparison
from recordings.comparing.truth_files import SUFFIXES, read_truth
from recordings.data import layout
from recordings.file.session_writer import whole_recording
from recordings.quality.figures import Figures
from recordings.session import Session
from viewer_app.errors import UsageError
from viewer_app.options.sessions import CompareOptions
from viewer_app.output_console import output_console
from viewer_app.output_files import check_outputs, check_page, save_report, write_text
from viewer_app.report.pages.comparison_figures import (
    BONES_HEAD,
    BONES_TITLE,
    JOINTS_HEAD,
    JOINTS_TITLE,
    bone_rows,
    distance_rows,
    lead,
    moments,
    other_settings,
)
from viewer_app.report.pages.truth_figures import (
    AGREEMENT_HEAD,
    ALL_HEAD,
    ANGLE_HEAD,
    JOINT_HEAD,
    STEP_HEAD,
    agreement_rows,
    all_rows,
    angle_rows,
    joint_rows,
    step_line,
    step_rows,
    truth_figures,
    truth_lines,
)
from viewer_app.report.terminal import figure_table, print_damage, print_lines
from viewer_app.report.words import Line
from viewer_app.viewer.file_window import written_and_shown
from viewer_app.viewer.viewer_choice import window_opens

_APPLICATION_ID = f"{layout.APPLICATION_ID}_compare"
_EYE = np.array([-0.9, -0.3, -2.0])  # metres, from the person in K_A's frame
_WORST = 5  # moments in which two sessions differ most
_OF_TRUTH = ("names", "offset", "report")  # options for motion capture only


def run(options: CompareOptions) -> None:
    """Runs the command."""
    console = output_console()
    if options.worst is not None and options.worst < 0:
        raise UsageError(f"--worst {options.worst}: must be 0 or more.")
    if options.offset is not None and not math.isfinite(options.offset):
        raise UsageError(f"--offset {options.offset}: must be a number of seconds.")
    inputs = [options.first, options.second]
    check_outputs([options.html, options.report], inputs, options.force, options.save)
    check_page(options.html)
    if options.second.suffix.lower() in SUFFIXES:
        for name, chosen in (("worst", options.worst is not None), ("any-capture", options.any_capture)):
            if chosen:
                raise UsageError(f"--{name} is for two sessions; {options.second} is motion capture.")
        _compare_with_truth(options, console)
    elif given := [name for name in _OF_TRUTH if getattr(options, name) is not None]:
        known = ", ".join(SUFFIXES)
        raise UsageError(f"--{given[0]} is for motion capture ({known}); {options.second} is not.")
    else:
        _compare_sessions(options, console)


def _compare_with_truth(options: CompareOptions, console: Console) -> None:
    table = None if options.names is None else name_table(options.names)
    session, truth = Session.open(options.first), read_truth(options.second)
    print_damage(console, session)
    if truth.warning:
        print_lines(console, [Line("", truth.warning, True)])
    comparison = TruthComparison.of(session, truth, table, options.offset)
    figures = truth_figures(comparison)
    if options.html is not None:
        from viewer_app.report.pages.truth_page import truth_page

        write_text(options.html, truth_page(session, comparison, figures), options.force)
    save_report(options.report, figures, options.force)
    window = window_opens(options.no_viewer, console)

    def write(path: Path) -> None:
        scene = "S_A, S_B, S* and the truth (green)"
        blueprint = _blueprint(scene, MEANS, "mean distance (mm)", session.whereabouts)
        with whole_recording(path, blueprint, _APPLICATION_ID) as stream:
            record_truth_comparison(stream, comparison)

    with written_and_shown(options.save, write, force=options.force, window=window):
        _print_truth_comparison(options, console, session, comparison, figures)


def _print_truth_comparison(
    options: CompareOptions, console: Console, session: Session, comparison: TruthComparison, figures: Figures
) -> None:
    joints, frames = len(comparison.joints), f"[bold]{len(comparison)}[/] of {len(session)} frames"
    names = f"{joints} joints by the table {escape(comparison.table)}, in {comparison.unit}"
    console.print(f"{frames} compared: {names}.", soft_wrap=True)
    print_lines(console, truth_lines(figures))
    console.print(figure_table("", ALL_HEAD, all_rows(figures)))
    head = "Angles, degrees: RMSE and correlation; range of motion"
    console.print(figure_table(head, ANGLE_HEAD, angle_rows(figures)))
    if steps := list(step_rows(figures)):
        head = "Steps, S* minus truth, with 95 % intervals in brackets"
        console.print(figure_table(head, STEP_HEAD, steps))
        console.print(step_line(figures))
    if options.verbose:
        head = "Angles, degrees, S* minus truth, with 95 % intervals in brackets"
        console.print(figure_table(head, AGREEMENT_HEAD, agreement_rows(figures)))
        head = "Joints, mm: mean distance, its constant part, mean of the rest"
        console.print(figure_table(head, JOINT_HEAD, joint_rows(figures)))
    for written in filter(None, (options.html, options.report, options.save)):
        console.print(f"Wrote {written}.", markup=False, soft_wrap=True)
    if not options.verbose:
        console.print("For every joint, use --verbose.")


def _compare_sessions(options: CompareOptions, console: Console) -> None:
    sessions = [Session.open(path) for path in (options.first, options.second)]
    for session in sessions:
        print_damage(console, session)
    comparison = Comparison.of(sessions[0], sessions[1], options.any_capture)
    worst = comparison.worst(_WORST if options.worst is None else options.worst)
    if options.html is not None:
        from viewer_app.report.pages.comparison_page import comparison_page

        write_text(options.html, comparison_page(sessions, comparison, worst), options.force)
    window = window_opens(options.no_viewer, console)

    def write(path: Path) -> None:
        scene = "first S* violet, second green"
        blueprint = _blueprint(scene, LARGEST, "largest difference (mm)", sessions[0].whereabouts)
        with whole_recording(path, blueprint, _APPLICATION_ID) as stream:
            record_comparison(stream, comparison, worst)

    at_ns = next((int(comparison.first.time_ns[t]) for t, _ in comparison.worst(1)), 0)
    with written_and_shown(options.save, write, force=options.force, window=window, at_ns=at_ns):
        _print_comparison(options, console, sessions, comparison, worst)


def _print_comparison(
    options: CompareOptions,
    console: Console,
    sessions: Sequence[Session],
    comparison: Comparison,
    worst: Sequence[tuple[int, int]],
) -> None:
    console.print(
        f"[bold]{len(comparison)}[/] frames in common, of {len(sessions[0])} and {len(sessions[1])}."
    )
    for line in other_settings(sessions):
        console.print(f"  {line}", markup=False)
    if comparison.one_missing:
        console.print(f"Only one of them has an S* in {comparison.one_missing} frames.")
    if options.verbose:
        console.print(figure_table(JOINTS_TITLE, JOINTS_HEAD, distance_rows(comparison)))
        console.print(figure_table(BONES_TITLE, BONES_HEAD, bone_rows(comparison)))
    else:
        print_lines(console, lead(comparison))
    if not np.any(comparison.apart > 0.0) and not comparison.one_missing:
        console.print("S* is the same in every frame they share.")
    for when, words in moments(comparison, worst):
        console.print(f"  {when:8.2f} s  {words}")
    for written in filter(None, (options.html, options.save)):
        console.print(f"Wrote {written}.", markup=False, soft_wrap=True)
    if not options.verbose:
        console.print("For every joint and bone, use --verbose.")


def _blueprint(scene: str, entity: str, plot: str, whereabouts: NDArray[np.float64]) -> rrb.Blueprint:
    """The layout: the scene above, below it the plots of an entity and of all joints' differences."""
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial3DView(
                origin=layout.ROOT,
                name=scene,
                eye_controls=rrb.EyeControls3D(
                    position=whereabouts + _EYE,
                    look_target=whereabouts,
                    eye_up=(0.0, -1.0, 0.0),
                    tracking_entity=layout.PELVIS,
                ),
                overrides={layout.PELVIS: entity_styles.followed(float(np.linalg.norm(_EYE)))},
                line_grid=rrb.LineGrid3D(visible=False),
            ),
            rrb.Horizontal(
                rrb.TimeSeriesView(origin=entity, name=plot),
                rrb.TimeSeriesView(
                    origin=DIFFERENCE,
                    name="difference of each joint (mm)",
                    plot_legend=rrb.PlotLegend(visible=False),
                ),
                *([rrb.TextLogView(origin=layout.EVENTS, name="worst moments")] if entity == LARGEST else []),
            ),
            row_shares=[3, 2],
        ),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=layout.TIME),
        auto_views=False,
    )
