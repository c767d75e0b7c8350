"""``duplex bench accuracy``: measures the accuracy of S* in millimetres, and the realism of the simulator."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from devices.pairing import pair_recordings
from devices.people import choose_person
from devices.simulated.person.movements import MOTIONS
from devices.simulated.realism.pair_statistics import statistics
from devices.simulated.realism.reference_figures import (
    COUNTERPARTS,
    Figure,
    figures,
    published_figures,
    simulated_statistics,
)
from devices.skeletons.file_sensor import SkeletonRecording
from viewer_app.bench.accuracy_methods import ABLATIONS, METHODS, WITHOUT_DEPTH
from viewer_app.bench.accuracy_picture import draw
from viewer_app.bench.accuracy_tables import said_of_losses, table_by, tables_of_methods
from viewer_app.bench.accuracy_trials import Outcome, Simulation, Trial, chosen_methods, run_trials
from viewer_app.errors import UsageError
from viewer_app.options.bench import BenchAccuracyOptions
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
    """Checks the options before the measurement starts."""
    if options.seeds < 1:
        raise UsageError(f"--seeds must be 1 or more; got {options.seeds}.")
    if options.first_seed < 0:
        raise UsageError(f"--first-seed must be 0 or more; got {options.first_seed}.")
    if options.processes < 0:
        raise UsageError(f"--processes must be 0 or more; got {options.processes}.")
    if not 0.0 < options.errors <= 10.0:
        raise UsageError(f"--errors must be a factor above 0, at most 10; got {options.errors}.")
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
    if beyond := [angle for angle in options.angles if not 0.0 <= angle <= 180.0]:
        raise UsageError(f"--angles must be between 0 and 180 degrees; got {beyond[0]}.")
    known = [method.name for method in (*METHODS, *ABLATIONS)]
    if unknown := [name for name in options.methods if name not in known]:
        raise UsageError(f"Methods must be among {'; '.join(known)}. Got {'; '.join(unknown)}.")
    if WITHOUT_DEPTH in options.methods and options.depth == "none":
        raise UsageError(f"The method '{WITHOUT_DEPTH}' needs depth images: add --depth half.")


def _methods(options: BenchAccuracyOptions) -> list[str]:
    """The names of the selected methods, in the tables' order."""
    if options.methods:
        return [method.name for method in chosen_methods(options.methods)]
    chosen = [method.name for method in (*METHODS, *(ABLATIONS if options.ablations else ()))]
    return [name for name in chosen if name != WITHOUT_DEPTH or options.depth != "none"]


def _compare_methods(console: Console, options: BenchAccuracyOptions) -> dict[str, Any]:
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    trials = [
        Trial(motion, angle, seed) for motion in options.motions for angle in options.angles for seed in seeds
    ]
    simulation = Simulation(
        options.body, options.seconds, options.errors, options.tracker_errors, options.depth
    )
    # a process takes seconds to start: at most one per four trials
    processes = options.processes or min(os.cpu_count() or 1, max(1, len(trials) // 4))
    outcomes: list[Outcome] = []
    runs = run_trials(trials, simulation, _methods(options), processes)
    for of_trial in track(
        runs, "measuring", total=len(trials), console=console, transient=True, disable=not console.is_terminal
    ):
        outcomes += of_trial
    harsher = f", errors × {options.errors:g}" if options.errors != 1.0 else ""
    harsher += ", heavy-tailed tracker errors" if options.tracker_errors == "heavy-tailed" else ""
    harsher += f", depth images at {options.depth} size" if options.depth != "none" else ""
    console.print(
        f"{options.body}: {len(options.motions)} movements × {len(options.angles)} angles × "
        f"{options.seeds} seeds ({seeds[0]}–{seeds[-1]}){harsher}, {options.seconds:g} s each, measured "
        "after the start-up pose.",
        highlight=False,
    )
    for table in (
        *tables_of_methods(outcomes),
        table_by("movement", lambda trial: trial.motion, outcomes),
        table_by("angle °", lambda trial: f"{trial.angle:g}", outcomes),
    ):
        console.print(table)
    for line in said_of_losses(outcomes):
        console.print(line, highlight=False)
    if options.picture is not None:
        draw(outcomes, options.picture)
    return {
        "body": options.body,
        "seconds": options.seconds,
        "first_seed": options.first_seed,
        "errors": options.errors,
        "tracker_errors": options.tracker_errors,
        "depth": options.depth,
        "processes": processes,
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


def _compare_with_real(console: Console, options: BenchAccuracyOptions) -> dict[str, Any]:
    compared: dict[str, list[Figure]] = {}
    for name, setting in COUNTERPARTS.items():
        with console.status(f"simulating {name}"):
            folder = None if options.recordings is None else options.recordings / name
            real = None
            if folder is not None and name != "azure_squat":  # no recording is available
                real = statistics(*_views(folder / "a.csv", folder / "b.csv"))
            simulated = simulated_statistics(
                setting, range(options.first_seed, options.first_seed + options.seeds)
            )
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
