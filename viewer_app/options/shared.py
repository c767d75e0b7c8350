"""Options that several commands share.

A class's own options come after those of its bases, and those of its last base come first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from fusion.setup import PAPER_H


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
class SummaryOptions:
    """How much the summary in the terminal says."""

    verbose: bool = False
    """Print all figures and every bone after the summary; keep every status line of a running loop."""


@dataclass(frozen=True)
class TerminalOptions(SummaryOptions):
    """Terminal output of a running loop."""

    quiet: bool = False
    """No status line and no advice, only warnings."""


@dataclass(frozen=True)
class FusionOptions:
    """Settings of the method, without its calibration."""

    h: float = PAPER_H
    """How much more a tracked joint counts than an inferred one, between 0.5 and 1."""
    method: Literal["duplex", "paper", "published"] = "duplex"
    """duplex: an estimator in time. paper: eqs. (10)-(13), exact bones. published: eqs. (3)-(9) as well."""
    smoothing: float = 0.5
    """How calm the joints are, from 0 (each frame by itself) to 1; of the method duplex."""
    weights: Literal["paper", "equal"] = "paper"
    """paper: trust a joint, eqs. (10), (11). equal: both views alike."""


@dataclass(frozen=True)
class MethodOptions(FusionOptions):
    """Settings of the method."""

    calibrate: str = "auto"
    """auto: calibrate on the start-up pose, once it is held. Or a file of --save-calibration."""
    save_calibration: Path | None = None
    """Save the sensors' placement and the bone lengths to a file."""


@dataclass(frozen=True)
class RecordingOptions:
    """How recordings are fused."""

    calibrate: str = "auto"
    """auto: on the start-up pose. seconds:N: on the first N seconds. Or a file of --save-calibration."""
    no_refine: bool = False
    """Keep the calibration of --calibrate, rather than refine it over the recording; of the method duplex."""
    smooth: Literal["off", "whole"] = "off"
    """whole: each frame counts what comes after it as well; no lag, and calmer. Of the method duplex."""
    unit: Literal["auto", "m", "cm", "mm", "ft", "in"] = "auto"
    """Unit of the positions in .csv files. auto: found from the size of the person."""
    depth: Literal["none", "half", "full"] = "full"
    """For an .mkv: its depth images in the session: none, every second pixel in both directions, or all."""


@dataclass(frozen=True)
class TrackerOptions:
    """Options of the body tracker."""

    tracker: Literal["auto", "blazepose", "k4abt"] = "auto"
    """Finds people in images. k4abt: Microsoft's, needs its library and a GPU. blazepose: the program's own,
    on any CPU. auto: k4abt where it works, else blazepose."""
    tracker_model: Path | None = None
    """Folder of blazepose's networks; if not given, the user's cache folder, into which they are fetched
    once."""
    tracker_network: Literal["full", "lite"] = "full"
    """Network of blazepose; lite is faster and less accurate."""
    k4abt: Path | None = None
    """Library of Microsoft's body tracker, libk4abt; if not given, the system's."""
    processing: Literal["gpu", "cpu", "cuda", "tensorrt", "directml"] = "gpu"
    """Where k4abt runs; on a CPU it tracks about one frame per second."""


@dataclass(frozen=True)
class SensorOptions:
    """Choice of the two sensors."""

    kinect_a: str | None = None
    """Serial number of the principal sensor K_A; S* is in its frame. zenoh:KEY: a sensor on another PC, of
    duplex sensor."""
    kinect_b: str | None = None
    """Serial number of the secondary sensor K_B, or zenoh:KEY."""
    principal: str | None = None
    """Serial number of the sensor that is K_A, if two are connected; if not given, duplex live asks."""
    sync_master: str | None = None
    """Serial number of the master on the sync cable; needed with Orbbec's wrapper, which cannot detect it."""


@dataclass(frozen=True)
class ZenohOptions:
    """Where Zenoh meets other programs and machines; only addresses given here are used."""

    zenoh_listen: tuple[str, ...] = ()
    """Wait for other machines on these addresses: tcp/0.0.0.0:7447 for all networks of this machine. If
    neither this nor --zenoh-connect is given: this machine only."""
    zenoh_connect: tuple[str, ...] = ()
    """Connect to others at these addresses: tcp/HOST:7447."""


@dataclass(frozen=True)
class LiveOutputOptions(ZenohOptions):
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

    @property
    def listens(self) -> bool:
        """Whether one of them waits for receivers on an address of this machine."""
        return self.websocket is not None or self.lsl is not None
