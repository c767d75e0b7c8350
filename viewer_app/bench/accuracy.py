"""``duplex bench accuracy``: what S* is worth in millimetres, and what the simulator is worth."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from devices.pairing import pair_recordings
from devices.recorded_person import choose_person
from devices.simulated.person.movements import MOTIONS
from devices.simulated.realism.pair_statistics import statistics
from devices.simulated.realism.reference_figures import (
    COUNTERPARTS,
    Figure,
    figures,
    published_figures,
    simulated_statistics,
)
from devices.skeletons.recording import SkeletonRecording
from fusion.body import BODIES
from viewer_app.bench.accuracy_tables import table_by, tables_of_methods
from viewer_app.bench.accuracy_trials import METHODS, Outcome, Trial, run_trials
from viewer_app.errors import UsageError
from viewer_app.options import BenchAccuracyOptions
from viewer_app.output_files import check_writable, whole_file


def run(options: BenchAccuracyOptions) -> None:
    """Carries out the command.

    Raises:
        DeviceError, FusionError, UsageError: With one line for the person who asked.
    """
    console = Console()
    _check(options)
    for path in filter(None, (options.json, options.picture)):
        check_writable(path, options.force)
    if options.set == "real":
        document = _compare_with_real(console, options)
    else:
        document = _compare_methods(console, options)
    if options.json is not None:
        with whole_file(options.json) as partial:
            partial.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _check(options: BenchAccuracyOptions) -> None:
    """Finds out before the work what cannot be done."""
    if options.seeds < 1:
        raise UsageError(f"--seeds must be 1 or more; got {options.seeds}.")
    if not 0.0 < options.seconds < float("inf"):
        raise UsageError(f"--seconds must be a positive number; got {options.seconds}.")
    if options.set == "real":
        if options.picture is not None:
            raise UsageError("--picture draws the methods: leave out --set real, or choose --json.")
        return
    if options.recordings is not None:
        raise UsageError("--recordings are compared with the simulator only: add --set real.")
    if not options.motions or not options.angles:
        raise UsageError("At least one of --motions and one of --angles is needed.")
    if unknown := [motion for motion in options.motions if motion not in MOTIONS]:
        raise UsageError(f"Movements must be among {', '.join(MOTIONS)}; got {', '.join(unknown)}.")


def _compare_methods(console: Console, options: BenchAccuracyOptions) -> dict[str, Any]:
    trials = [
        Trial(motion, angle, seed)
        for motion in options.motions
        for angle in options.angles
        for seed in range(options.seeds)
    ]
    outcomes: list[Outcome] = []
    runs = run_trials(trials, BODIES[options.body], options.seconds)
    for of_trial in track(
        runs, "measuring", total=len(trials), console=console, transient=True, disable=not console.is_terminal
    ):
        outcomes += of_trial
    console.print(
        f"{options.body}: {len(options.motions)} movements × {len(options.angles)} angles × "
        f"{options.seeds} seeds, {options.seconds:g} s each, measured after the start-up pose.",
        highlight=False,
    )
    for table in (
        *tables_of_methods(outcomes),
        table_by("movement", lambda trial: trial.motion, outcomes),
        table_by("angle °", lambda trial: f"{trial.angle:g}", outcomes),
    ):
        console.print(table)
    if options.picture is not None:
        _draw(outcomes, options.picture)
    return {
        "body": options.body,
        "seconds": options.seconds,
        "trials": [
            {
                "motion": o.trial.motion,
                "angle_deg": o.trial.angle,
                "seed": o.trial.seed,
                "method": o.method,
                **{name: value if np.isfinite(value) else None for name, value in o.figures.items()},
            }
            for o in outcomes
        ],
    }


def _draw(outcomes: list[Outcome], path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    motions = list(dict.fromkeys(o.trial.motion for o in outcomes))
    colors = dict(
        zip(
            METHODS,
            ("#b87333", "#3a86ff", "#9aa0a6", "#6c757d", "#e0a800", "#7fb069", "#b24ee8"),
            strict=True,
        )
    )
    figure, axes = pyplot.subplots(figsize=(10.0, 4.2), dpi=110, layout="constrained")
    width = 0.8 / len(METHODS)
    for k, method in enumerate(METHODS):
        by_motion = [
            1e3
            * np.array([o.figures["mpjpe"] for o in outcomes if o.method == method and o.trial.motion == m])
            for m in motions
        ]
        axes.bar(
            np.arange(len(motions)) + (k - (len(METHODS) - 1) / 2) * width,
            [values.mean() for values in by_motion],
            width,
            yerr=[values.std() for values in by_motion],
            error_kw={"elinewidth": 0.7, "ecolor": "#555555"},
            color=colors[method],
            label=method,
        )
    axes.set_xticks(np.arange(len(motions)), motions)
    axes.set_ylabel("MPJPE (mm)")
    axes.set_title("Distance from the true joints, by movement (bars: deviation over angles and seeds)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(ncols=len(METHODS), frameon=False, fontsize=9, loc="outside lower center")
    with whole_file(path) as partial:
        figure.savefig(partial, format="png")
    pyplot.close(figure)


def _compare_with_real(console: Console, options: BenchAccuracyOptions) -> dict[str, Any]:
    compared: dict[str, list[Figure]] = {}
    for name, setting in COUNTERPARTS.items():
        with console.status(f"simulating {name}"):
            folder = None if options.recordings is None else options.recordings / name
            real = None
            if folder is not None and name != "azure_squat":  # of which no recording is at hand
                real = statistics(*_views(folder / "a.csv", folder / "b.csv"))
            simulated = simulated_statistics(setting, range(options.seeds))
            if real is not None:
                compared[name] = figures(real, simulated, standing=setting.motion == "still")
            compared[f"{name}, published"] = published_figures(name, simulated)
    for name, found in compared.items():
        _print_figures(console, name.replace("_", " "), found)
    if options.recordings is None:
        console.print("With --recordings FOLDER, real pairs FOLDER/NAME/a.csv and b.csv are compared too.")
    return {
        name: [
            {"figure": f.name, "reason": f.reason, "within_1.5": f.within(1.5) if f.known else None}
            | {
                key: value if np.isfinite(value) else None
                for key, value in (
                    ("real_low", f.low),
                    ("real_high", f.high),
                    ("simulated", f.simulated),
                    ("ratio", f.ratio),
                )
            }
            for f in found
        ]
        for name, found in compared.items()
    }


def _print_figures(console: Console, title: str, found: list[Figure]) -> None:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD)
    for column in ("figure", "real", "simulated", "ratio", "within 1.5"):
        table.add_column(column, justify="left" if column == "figure" else "right", no_wrap=True)
    known = [figure for figure in found if figure.known]
    for figure in found:
        verdict = ("yes" if figure.within(1.5) else "[bold]no[/]") if figure.known else "–"
        table.add_row(*figure.printed(), verdict)
    console.print(table)
    within = sum(figure.within(1.5) for figure in known)
    ratios = [figure.ratio for figure in known if figure.ratio > 0.0]
    farthest = f"; farthest ratio {max(ratios, key=lambda ratio: abs(np.log(ratio))):.2f}" if ratios else ""
    console.print(f"{within} of {len(known)} figures within 1.5{farthest}.", highlight=False)
    for figure in found:
        if figure.reason and not (figure.known and np.isfinite(figure.ratio) and figure.within(1.5)):
            console.print(f"{figure.name.replace('_', ' ')}: {figure.reason}.", highlight=False)
    console.print()


def _views(path_a: Path, path_b: Path) -> tuple[list[Any], list[Any]]:
    """Both views' skeletons of a recorded pair, paired in time."""
    with SkeletonRecording(path_a) as a, SkeletonRecording(path_b) as b:
        frames_a, frames_b = list(a.frames()), list(b.frames())
    person_a = choose_person(frames_a, None, a.name, "")
    person_b = choose_person(frames_b, None, b.name, "")
    pairs = [pair.skeletons for pair in pair_recordings(frames_a, frames_b, person_a, person_b).pairs]
    return [pair.a for pair in pairs], [pair.b for pair in pairs]
