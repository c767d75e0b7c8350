"""The command line as values: a command is a frozen dataclass, its field docstrings are the help text.

Nothing heavy is imported here, so that ``duplex --help`` answers at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from tyro.conf import Positional


@dataclass(frozen=True)
class FuseOptions:
    """Fuse two recorded skeleton streams into one skeleton with bones of constant length.

    Recordings are .csv (time_us,body,joint,x,y,z[,state]; metres), .json (Microsoft's offline_processor)
    or .skeleton (NTU RGB+D).
    """

    a: Positional[Path]
    """Recording of the principal sensor K_A; S* is in its frame."""
    b: Positional[Path]
    """Recording of the secondary sensor K_B."""
    save: Path | None = None
    """Keep the session as an .rrd file."""
    report: Path | None = None
    """Write all figures of the summary as JSON."""
    no_viewer: bool = False
    """Do not open the viewer."""
    person_a: str | None = None
    """Id of the person in A; the one seen longest if not given."""
    person_b: str | None = None
    """Id of the person in B; the one seen longest if not given."""
    h: float = 0.786
    """How much more a tracked joint counts than an inferred one, between 0.5 and 1."""
    solver: Literal["exact", "paper"] = "exact"
    """exact: one constraint a bone. paper: eqs. (3)-(9) as published."""
    weights: Literal["paper", "equal"] = "paper"
    """paper: trust a joint, eqs. (10), (11). equal: both views alike."""
    calibrate: str = "auto"
    """auto: on the start-up pose. seconds:N: on the first N seconds. Or a file of --save-calibration."""
    save_calibration: Path | None = None
    """Keep the sensors' placement and the bone lengths in a file."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class BenchSpeedOptions:
    """What a frame costs on this machine: solvers side by side, the update by stages, batch and writing."""

    json: Path | None = None
    """Write all figures as JSON."""
    recording: tuple[Path, Path] | None = None
    """Recordings A and B to measure warm starts and the update on; simulated sensors where not given."""
    force: bool = False
    """Overwrite files that exist."""
