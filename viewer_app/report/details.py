"""All figures of a fusion in the terminal: what ``--verbose`` adds to the summary."""

from __future__ import annotations

import math

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from fusion.calibration.calibration import Calibration
from viewer_app.coach.advice import ANGLES, quality
from viewer_app.report.figures import Figures, FusionResult
from viewer_app.report.numbers_in_words import in_mm


def print_details(console: Console, result: FusionResult, figures: Figures) -> None:
    """Prints pairing, calibration, bones, errors, time."""
    dropped, stale, alone = figures["dropped"], figures["stale"], figures["without_person"]
    console.print(
        f"[bold]Paired[/] {figures['paired']} frames of {figures['frames']['a']} (A) and "
        f"{figures['frames']['b']} (B); dropped {dropped['a']} and {dropped['b']}; "
        f"repeated by the sensor {stale['a']} and {stale['b']}."
    )
    if alone["a"] or alone["b"]:
        console.print(
            f"No person in {alone['a']} frames of A, {alone['b']} of B, {alone['both']} of both: "
            "S* comes from the other sensor, or there is none."
        )
    print_method(console, result.calibration, figures)
    if result.exact is not None:
        console.print(_comparison_table(figures["compared_with_exact"]))


def print_method(console: Console, calibration: Calibration, figures: Figures) -> None:
    """Prints the figures of the method for recorded and live sessions: calibration, bones, errors, time."""
    how, *verdict = calibration_in_words(calibration)
    console.print(f"[bold]Calibration[/]: {escape(how)}", highlight=False)
    for line in verdict:
        console.print(f"  {line}", highlight=False, markup=False)
    console.print(_bone_table(figures))
    error, apart = figures["bone_error_mm"], figures["disagreement_mm"]
    console.print(
        f"[bold]Largest bone error[/]: S_A {in_mm(error['a']['max'])}, S_B {in_mm(error['b']['max'])}, "
        f"[bold]S* {in_mm(error['fused']['max'])}[/]"
    )
    console.print(f"[bold]S_A against S_B[/]: median {in_mm(apart['median'])}, 95 % {in_mm(apart['p95'])}")
    ms = figures["fuse_ms"]
    console.print(
        f"[bold]Fusion[/]: {ms['p50']:.3f} ms per frame (median), 99 % {ms['p99']:.3f} ms, "
        f"max {ms['max']:.3f} ms"
    )


FEWEST_FRAMES = 15  # half a second


def calibration_in_words(calibration: Calibration) -> list[str]:
    """The source of the calibration, and the verdict, as lines."""
    registration = calibration.registration
    lines = [f"{calibration.how}."]
    angle = math.degrees(calibration.axes_angle)
    low, high = ANGLES
    advice = "" if low <= angle <= high else " (about 90° lets each sensor see most of what the other cannot)"
    if registration is None:
        return [*lines, f"The sensors' axes are {angle:.0f}° apart{advice}."]
    median, rms = registration.residual_median * 1e3, registration.residual_rms * 1e3
    verdict: str = quality(median)
    if registration.frames < FEWEST_FRAMES:
        verdict = f"too few frames to trust ({FEWEST_FRAMES} at least)"
    worst = ", ".join(f"{name} {distance * 1e3:.0f} mm" for name, distance in registration.worst_joints())
    uncertain = math.degrees(registration.rotation_sd)
    lines.append(
        f"{verdict.capitalize()}: the views differ by {median:.0f} mm (median), {rms:.0f} mm (RMS), over "
        f"{registration.frames} frames; worst: {worst}."
    )
    lines.append(
        f"The sensors' axes are {angle:.0f}° apart{advice}; "
        f"that rotation is certain to about {uncertain:.1f}°."
    )
    return lines


def _comparison_table(figures: Figures) -> Table:
    apart = figures["difference_mm"]
    table = Table(
        title="The paper's scheme beside the exact solver, same frames and weights",
        caption=f"Joints differ by {in_mm(apart['median'])} (median), {in_mm(apart['max'])} at most.",
        title_justify="left",
        caption_justify="left",
    )
    for column in ("solver", "largest bone error", "iterations (median)", "at the limit", "ms per frame"):
        table.add_column(column, justify="left" if column == "solver" else "right")
    for name in ("paper", "exact"):
        solver = figures[name]
        table.add_row(
            name,
            in_mm(solver["max_bone_error_mm"]),
            f"{solver['median_iterations']:.0f}",
            f"{solver['at_iteration_limit']} frames",
            f"{solver['fuse_ms_p50']:.3f}",
        )
    return table


def _bone_table(figures: Figures) -> Table:
    table = Table(title="Bones: target, and mean ± deviation in mm", title_justify="left")
    for column in ("bone", "target", "S_A", "S_B", "S*"):
        table.add_column(column, justify="left" if column == "bone" else "right")
    for name, of_bone in figures["bones"].items():
        table.add_row(
            name.replace("_", " "),
            f"{of_bone['target_m'] * 1e3:.0f}",
            *(_mean_and_deviation(of_bone[key]) for key in ("a", "b", "fused")),
        )
    return table


def _mean_and_deviation(of_bone: Figures) -> str:
    if of_bone["mean_m"] is None:
        return "–"
    return f"{of_bone['mean_m'] * 1e3:.0f} ± {of_bone['std_mm']:.1f}"
