"""Settings of a Kinect, and their translation for libk4a."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from devices.azure.calibration import COLOR_MODES, depth_mode
from devices.sensor import DeviceError

LASER_GAP_US = 160
"""How much later than the master a subordinate captures, so that their lasers do not blind each other."""
SYNC_COLOR = "720P"
"""The colour mode of sensors on a sync cable when nobody asked for colour: the cheapest.

libk4a refuses a master without colour. A subordinate runs colour too: libk4a holds depth back until the
colour image of its moment is there, so that colour on the master alone would delay A against B by the
colour camera's latency; and firmware before 1.6.110 cannot restart a subordinate without colour.
"""


@dataclass(frozen=True)
class KinectSettings:
    """How a Kinect runs.

    Attributes:
        depth_mode: NFOV_UNBINNED or WFOV_2X2BINNED, which the body tracker takes; others without a tracker.
        fps: 5, 15 or 30.
        color: Colour resolution, ``720P`` to ``3072P``; None for no colour images. On a sync cable the
            colour camera runs all the same, and its images are dropped.
        infrared: Whether frames carry the infrared image. The body tracker gets it anyway.
        sync: Its place on the sync cable.
        trust_jacks: Whether to ask the sync jacks if a cable is there. Orbbec's wrapper always says no.
        delay_us: How much later than the master a subordinate captures.
        timeout_ms: How long one wait for a frame may take.
        stall_s: After how long without depth the stream counts as stalled.
        start_s: The same for a subordinate's first frame, which waits until its master runs.
    """

    depth_mode: str = "NFOV_UNBINNED"
    fps: Literal[5, 15, 30] = 30
    color: str | None = None
    infrared: bool = False
    sync: Literal["standalone", "master", "subordinate"] = "standalone"
    trust_jacks: bool = True
    delay_us: int = LASER_GAP_US
    timeout_ms: int = 1000
    stall_s: float = 5.0
    start_s: float = 120.0

    @property
    def camera_color(self) -> str | None:
        """The mode in which the colour camera runs, whether its images are asked for or not."""
        return SYNC_COLOR if self.color is None and self.sync != "standalone" else self.color


def check_modes(settings: KinectSettings) -> None:
    """Finds out without a sensor whether it can run so.

    Raises:
        DeviceError: A mode that the sensor does not have, or not at this rate.
    """
    depth_mode(settings.depth_mode)
    color = settings.camera_color
    if color is not None and color not in COLOR_MODES:
        raise DeviceError(f"No colour mode {color}. There are {', '.join(COLOR_MODES)}.")
    if settings.fps == 30 and (settings.depth_mode == "WFOV_UNBINNED" or color == "3072P"):
        mode = "WFOV_UNBINNED" if settings.depth_mode == "WFOV_UNBINNED" else "Colour 3072P"
        raise DeviceError(f"{mode} runs at 15 fps at most, not 30. Choose 15 fps or another mode.")


def sdk_configuration(sdk: Any, settings: KinectSettings) -> Any:
    """The ``pyk4a.Config`` for these settings.

    Raises:
        DeviceError: A mode that the sensor does not have, or not at this rate.
    """
    check_modes(settings)
    color = settings.camera_color
    return sdk.Config(
        color_resolution=sdk.ColorResolution[f"RES_{color}" if color else "OFF"],
        color_format=sdk.ImageFormat.COLOR_MJPG,
        depth_mode=sdk.DepthMode[settings.depth_mode],
        camera_fps=sdk.FPS[f"FPS_{settings.fps}"],
        # True would drop every depth image whose colour image is late or missing.
        synchronized_images_only=False,
        wired_sync_mode=sdk.WiredSyncMode[settings.sync.upper()],
        subordinate_delay_off_master_usec=settings.delay_us if settings.sync == "subordinate" else 0,
    )
