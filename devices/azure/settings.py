"""Settings of a Kinect, and their translation for libk4a."""

from dataclasses import dataclass
from typing import Any

from devices.azure.calibration import COLOR_SIZES, depth_mode
from devices.capture.settings import CaptureSettings
from devices.sensor import DeviceError

SYNC_COLOR = "720P"
"""The colour mode of sensors on a sync cable when nobody asked for colour: the cheapest.

libk4a refuses a master without colour, and firmware before 1.6.110 cannot restart a subordinate without it.
"""


@dataclass(frozen=True)
class KinectSettings(CaptureSettings):
    """How a Kinect runs.

    Depth modes other than NFOV_UNBINNED and WFOV_2X2BINNED need a sensor without a body tracker. On a sync
    cable the colour camera runs without ``color``, too, and its images are dropped.
    """

    infrared: bool = False
    """Whether frames carry the infrared image. The body tracker gets it anyway."""
    trust_jacks: bool = True
    """Whether to ask the sync jacks if a cable is there. Orbbec's wrapper always says no."""

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
    if color is not None and color not in COLOR_SIZES:
        raise DeviceError(f"No colour mode {color}. There are {', '.join(COLOR_SIZES)}.")
    if settings.fps == 30 and (settings.depth_mode == "WFOV_UNBINNED" or color == "3072P"):
        mode = "WFOV_UNBINNED" if settings.depth_mode == "WFOV_UNBINNED" else "Colour 3072P"
        raise DeviceError(f"{mode} runs at 15 fps at most, not 30. Choose 15 fps or another mode.")


def sdk_configuration(sdk: Any, settings: KinectSettings) -> Any:
    """The ``pyk4a.Config`` for these settings."""
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
