"""The figures of a fusion: ``report.json`` and the summary in the terminal."""

from __future__ import annotations

import json
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from devices.pairing import Pairing
from fusion.calibration.calibration import Calibration
from fusion.setup import FuserSettings
from fusion.solvers.solver import MAX_ITERATIONS
from recordings.session_arrays import SessionArrays
from viewer_app.coach.advice import ANGLES, quality
from viewer_app.report.numbers_in_words import in_mm
from viewer_app.viewer.display import has_display

Figures = dict[str, Any]


@dataclass(frozen=True, eq=False)
class FusionResult:
    """The data of a report.

    Attributes:
        pairing: Counts of paired and dropped frames.
        calibration: The calibration used.
        settings: The settings used.
        rows: The fused frames.
        exact: The same frames solved with exact bones, if the published scheme was used; else None.
    """

    pairing: Pairing
    calibration: Calibration
    settings: FuserSettings
    rows: SessionArrays
    exact: SessionArrays | None = None


def report(result: FusionResult) -> Figures:
    """The report as plain data; figures that do not exist are None."""
    pairing = result.pairing
    figures: Figures = {
        "frames": {"a": pairing.frames_a, "b": pairing.frames_b},
        "paired": len(pairing.pairs) - pairing.alone_a - pairing.alone_b,
        "alone": {"a": pairing.alone_a, "b": pairing.alone_b},
        "dropped": {"a": pairing.dropped_a, "b": pairing.dropped_b},
        **fusion_figures(result.calibration, result.settings, result.rows),
    }
    if result.exact is not None:
        figures["compared_with_exact"] = _comparison(result.rows, result.exact)
    return figures


def fusion_figures(calibration: Calibration, settings: FuserSettings, rows: SessionArrays) -> Figures:
    """The figures of fused frames from any source."""
    registration = calibration.registration
    return {
        "stale": {"a": int(rows.stale_a.sum()), "b": int(rows.stale_b.sum())},
        "without_person": {
            "a": int((rows.states_a == 0).all(axis=1).sum()),
            "b": int((rows.states_b == 0).all(axis=1).sum()),
            "both": int(rows.predicted.all(axis=1).sum()),
        },
        "settings": {
            "method": settings.method,
            "h": settings.h,
            "weights": settings.weights,
            "smoothing": settings.smoothing,
        },
        "calibration": {
            "how": calibration.how,
            "residual_mm": None
            if registration is None
            else {"median": registration.residual_median * 1e3, "rms": registration.residual_rms * 1e3},
            "axes_angle_deg": math.degrees(calibration.axes_angle),
            "rotation_sd_deg": None if registration is None else math.degrees(registration.rotation_sd),
            "frames": None if registration is None else registration.frames,
            "worst_joints_mm": {}
            if registration is None
            else {name: distance * 1e3 for name, distance in registration.worst_joints()},
        },
        **method_figures(rows),
    }


def method_figures(rows: SessionArrays) -> Figures:
    """Bones, errors, disagreement and time of fused frames."""
    lengths, target = rows.bone_length_of_each, rows.bone_lengths
    disagreement = rows.disagreement * 1e3
    bones = {}
    for joint in rows.body.bone_joints:
        of_bone: Figures = {"target_m": float(target[-1, joint])}
        for key, length in zip(("a", "b", "fused"), lengths[:, :, joint], strict=True):
            of_bone[key] = {"mean_m": _of(np.mean, length), "std_mm": _of(np.std, length * 1e3)}
        of_bone["fused"]["max_error_mm"] = _of(np.max, np.abs(lengths[2, :, joint] - target[:, joint]) * 1e3)
        bones[rows.body.bones[joint]] = of_bone
    error = (lengths - target)[:, :, rows.body.bone_joints] * 1e3
    return {
        "bones": bones,
        "bone_error_mm": {
            key: {"rms": _of(_rms, error[k]), "max": _of(np.max, np.abs(error[k]))}
            for k, key in enumerate(("a", "b", "fused"))
        },
        "disagreement_mm": {"median": _of(np.median, disagreement), "p95": _percentile(disagreement, 95)},
        "fuse_ms": {
            "p50": _percentile(rows.fuse_ms, 50),
            "p99": _percentile(rows.fuse_ms, 99),
            "max": _of(np.max, rows.fuse_ms),
        },
    }


def report_to_json(figures: Figures) -> str:
    """The report as standard JSON."""
    return json.dumps(figures, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def print_summary(console: Console, result: FusionResult, figures: Figures) -> None:
    """Prints the summary: pairing, calibration, bones, errors, time."""
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


def say_saved(console: Console, path: Path) -> None:
    """Prints where the session is, and the command to view it, as this program was called."""
    program = sys.argv[0] if Path(sys.argv[0]).name.startswith("duplex") else "duplex"
    page = "" if has_display() else f" --html {path.with_suffix('.html')}"
    console.print(
        f"Saved {path}. Look at it with: {program} review {path}{page}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


_FEWEST_FRAMES = 15  # half a second


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
    if registration.frames < _FEWEST_FRAMES:
        verdict = f"too few frames to trust ({_FEWEST_FRAMES} at least)"
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


def _comparison(rows: SessionArrays, exact: SessionArrays) -> Figures:
    apart = np.linalg.norm(rows.fused - exact.fused, axis=2) * 1e3
    return {
        "difference_mm": {"median": _of(np.median, apart), "max": _of(np.max, apart)},
        **{
            name: {
                "max_bone_error_mm": _of(np.max, of.bone_error * 1e3),
                "median_iterations": _of(np.median, of.iterations),
                "at_iteration_limit": int((of.iterations >= MAX_ITERATIONS).sum()),
                "fuse_ms_p50": _percentile(of.fuse_ms, 50),
            }
            for name, of in (("paper", rows), ("exact", exact))
        },
    }


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


def _of(figure: Any, values: NDArray[Any]) -> float | None:
    """A figure of the finite values; None if there are none."""
    finite = np.asarray(values, dtype=np.float64)
    finite = finite[np.isfinite(finite)]
    return float(figure(finite)) if finite.size else None


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _percentile(values: NDArray[Any], percent: float) -> float | None:
    return _of(lambda finite: np.percentile(finite, percent), values)
