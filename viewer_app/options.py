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
    web: bool = False
    """Show the session in a browser instead of a window."""
    listen: str | None = None
    """With --web: an address of this machine to be reached at, by others too. Else only from here."""
    layout: Literal["setup", "inspect", "report"] = "inspect"
    """Which of the viewer's tabs is open at first."""
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
