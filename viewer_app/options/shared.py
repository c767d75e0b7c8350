"""Options that several commands share.

A class's own options come after those of its bases, and those of its last base come first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fusion.paper_constants import PAPER_H


@dataclass(frozen=True)
class OutputOptions:
    """The files that a command writes."""

    save: Path | None = None
    """Keep the session as an .rrd file."""
    report: Path | None = None
    """Write all figures of the summary as JSON."""
    force: bool = False
    """Overwrite files that exist."""


@dataclass(frozen=True)
class ViewerOptions:
    """How a running session is shown."""

    no_viewer: bool = False
    """Do not open the viewer."""
    web: bool = False
    """Show the session in a browser instead of a window."""
    listen: str | None = None
    """With --web, --websocket or --lsl: the address of this machine to listen on, also for other machines.
    Default: this machine only."""
    layout: Literal["setup", "inspect", "report"] = "inspect"
    """Which of the viewer's tabs is open at first."""


@dataclass(frozen=True)
class TerminalOptions:
    """Terminal output of a running loop."""

    quiet: bool = False
    """No status line and no advice, only warnings."""
    verbose: bool = False
    """Keep every status line."""


@dataclass(frozen=True)
class MethodOptions:
    """Settings of the method."""

    calibrate: str = "auto"
    """auto: calibrate on the start-up pose, once it is held. Or a file of --save-calibration."""
    save_calibration: Path | None = None
    """Save the sensors' placement and the bone lengths to a file."""
    h: float = PAPER_H
    """How much more a tracked joint counts than an inferred one, between 0.5 and 1."""
    method: Literal["duplex", "paper", "published"] = "duplex"
    """duplex: an estimator in time. paper: eqs. (10)-(13), exact bones. published: eqs. (3)-(9) as well."""
    smoothing: float = 0.5
    """How calm the joints are, from 0 (each frame by itself) to 1; of the method duplex."""
    weights: Literal["paper", "equal"] = "paper"
    """paper: trust a joint, eqs. (10), (11). equal: both views alike."""


@dataclass(frozen=True)
class TrackerOptions:
    """Options of the body tracker."""

    k4abt: Path | None = None
    """Library of Microsoft's body tracker, libk4abt; if not given, the system's."""
    processing: Literal["gpu", "cpu", "cuda", "tensorrt", "directml"] = "gpu"
    """Where the body tracker runs; a CPU tracks about one frame per second."""


@dataclass(frozen=True)
class SensorOptions:
    """Choice of the two sensors."""

    kinect_a: str | None = None
    """Serial number of the principal sensor K_A; S* is in its frame."""
    kinect_b: str | None = None
    """Serial number of the secondary sensor K_B."""
    principal: str | None = None
    """Serial number of the sensor that is K_A, if two are connected; if not given, duplex live asks."""
    sync_master: str | None = None
    """Serial number of the master on the sync cable; needed with Orbbec's wrapper, which cannot detect it."""


@dataclass(frozen=True)
class LiveOutputOptions:
    """Where S* is sent while the loop runs."""

    vmc: str | None = None
    """HOST:PORT of a VMC receiver: VSeeFace, Warudo, Unity, Unreal, Blender; usually port 39539."""
    avatar: Path | None = None
    """With --vmc: a .vrm, whose proportions are sent instead of the person's."""
    vrchat: str | None = None
    """HOST:PORT of VRChat's OSC trackers; usually port 9000."""
    lsl: str | None = None
    """Name of a Lab Streaming Layer stream; needs the extra lsl."""
    websocket: int | None = None
    """Port of a WebSocket server: JSON, and a page that draws the skeleton."""
    zenoh: str | None = None
    """Zenoh key to publish JSON under; needs the extra zenoh."""
    zenoh_listen: str | None = None
    """With --zenoh: address to listen on, such as tcp/0.0.0.0:7447. If neither this nor --zenoh-connect is
    given: this machine only."""
    zenoh_connect: tuple[str, ...] = ()
    """With --zenoh: addresses of routers or peers to connect to, tcp/HOST:PORT."""

    @property
    def listens(self) -> bool:
        """Whether one of them waits for receivers on an address of this machine."""
        return self.websocket is not None or self.lsl is not None
