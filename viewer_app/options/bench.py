"""Options of the group ``bench``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from viewer_app.options.shared import ARGUMENT

_BENCH_MOTIONS = ("walk", "arms", "badminton", "basketball", "squat", "sit", "boxing", "still")


@dataclass(frozen=True)
class BenchAccuracyOptions:
    """Measure the accuracy of S* in millimetres: methods side by side on simulated sensors with known
    truth."""

    set: Literal["simulated", "real"] = "simulated"
    """simulated: the methods against the truth. real: the simulator against figures of real sensors."""
    motions: tuple[str, ...] = _BENCH_MOTIONS
    """Movements of the library."""
    angles: tuple[float, ...] = (45.0, 90.0, 135.0)
    """Degrees between the sensors."""
    seeds: int = 10
    """How many recordings of each movement and angle, each with its own seed."""
    first_seed: int = 0
    """The first seed; the others follow it."""
    seconds: float = 20.0
    """Duration of each recording."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect", "blazepose"] = "azure_kinect"
    """Whose body tracker is simulated."""
    errors: float = 1.0
    """Factor for all errors of the tracker."""
    tracker_errors: Literal["fitted", "heavy-tailed"] = "fitted"
    """fitted: fitted to real recordings. heavy-tailed: another error model, to which nothing is fitted."""
    depth: Literal["none", "half", "full"] = "none"
    """Simulate depth images of this size, which S* uses as evidence; slower."""
    methods: tuple[str, ...] = ()
    """Only these methods, by their names in the tables; all but the ablations if not given."""
    ablations: bool = False
    """Add our method with one part switched off at a time."""
    processes: int = 0
    """Number of recordings processed in parallel; 0: one per processor."""
    recordings: Path | None = None
    """With --set real: a folder of real pairs NAME/a.csv, NAME/b.csv to compare with, too."""
    json: Path | None = None
    """Write all figures as JSON."""
    picture: Path | None = None
    """Draw the comparison as a PNG."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class BenchRealOptions:
    """Judge S* on recordings of real sensors without ground truth: calm, jumps, facing, registration,
    faults."""

    paths: Annotated[tuple[Path, ...], ARGUMENT]
    """Folders, each with a.csv and b.csv, or two recordings."""
    no_faults: bool = False
    """Leave out the artificial faults, which take most of the time."""
    json: Path | None = None
    """Write all figures as JSON, in SI units."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class BenchSpeedOptions:
    """Measure the time per frame on this machine: solvers, update by stages, batch and writing."""

    json: Path | None = None
    """Write all figures as JSON."""
    recording: tuple[Path, Path] | None = None
    """Recordings A and B for measuring warm starts and the update; if not given, simulated sensors."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class BenchOutputsOptions:
    """Measure live outputs on this machine: encoding, and the delay from the fusion to a VMC receiver."""

    seconds: float = 30.0
    """Duration of the live loop on two simulated sensors."""
    body: Literal["kinect_v1", "kinect_v2", "azure_kinect"] = "azure_kinect"
    """Whose body tracker is simulated."""
    json: Path | None = None
    """Write all figures as JSON."""
    force: bool = False
    """Overwrite files that exist."""
