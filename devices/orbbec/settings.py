"""Settings of an Orbbec sensor, and the place it takes on a sync cable."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from devices.azure.kinect_settings import LASER_GAP_US
from devices.orbbec.sdk_access import faults_of
from devices.sensor import DeviceError


@dataclass(frozen=True)
class OrbbecSettings:
    """How an Orbbec sensor runs.

    Attributes:
        depth_mode: NFOV_UNBINNED (640 × 576) or WFOV_2X2BINNED (512 × 512), the modes of Femto Bolt and
            Mega. A sensor with other sizes runs in that nearest to 640 pixels wide.
        fps: Frames per second.
        color: Colour resolution, ``720P`` to ``2160P``; None for no colour images.
        sync: Its place on the sync cable.
        delay_us: How much later than the primary a secondary captures.
        timeout_ms: How long one wait for a frame may take.
        stall_s: After how long without depth the stream counts as stalled.
        start_s: The same for a secondary's first frame, which waits until its primary runs.
    """

    depth_mode: str = "NFOV_UNBINNED"
    fps: Literal[5, 15, 30] = 30
    color: str | None = None
    sync: Literal["standalone", "primary", "secondary"] = "standalone"
    delay_us: int = LASER_GAP_US
    timeout_ms: int = 1000
    stall_s: float = 5.0
    start_s: float = 120.0


def set_sync_role(sdk: Any, device: Any, serial: str, settings: OrbbecSettings) -> str:
    """Gives an opened sensor its place on the sync cable.

    Sensors keep their place when they lose power, so standalone is set explicitly: a sensor that was left a
    secondary would wait for a primary for ever. Femto Bolt and Mega have the mode SECONDARY, Gemini 2
    SECONDARY_SYNCED (Orbbec, Multi-Device-Synchronization-Example); the sensor is asked which it has.

    Returns:
        A warning; empty if there is none.

    Raises:
        DeviceError: The sensor cannot take that place.
    """
    modes = sdk.OBMultiDeviceSyncMode
    choices = {
        "standalone": (modes.STANDALONE, modes.FREE_RUN),
        "primary": (modes.PRIMARY,),
        "secondary": (modes.SECONDARY_SYNCED, modes.SECONDARY),
    }[settings.sync]
    try:
        supported = device.get_supported_multi_device_sync_mode_bitmap()
        mode = next((mode for mode in choices if supported & int(mode)), None)
        if mode is None:
            if settings.sync == "standalone":
                return ""
            raise DeviceError(
                f"Orbbec {serial} cannot be a sync cable's {settings.sync}. Leave --sync-master out."
            )
        wanted = device.get_multi_device_sync_config()
        wanted.mode = mode
        wanted.trigger_out_enable = settings.sync == "primary"
        delay_us = settings.delay_us if settings.sync == "secondary" else 0
        wanted.depth_delay_us = wanted.color_delay_us = delay_us
        device.set_multi_device_sync_config(wanted)
        kept_us = device.get_multi_device_sync_config().depth_delay_us
    except faults_of(sdk) as fault:
        if settings.sync == "standalone":
            return ""  # a sensor without a sync port
        raise DeviceError(
            f"Orbbec {serial} does not take its place on the sync cable ({fault}). Check the sync hub, its "
            f"power and the cables, or leave --sync-master out."
        ) from fault
    if kept_us != delay_us:  # reported of a Femto Bolt with firmware 1.1.2: OrbbecSDK_v2 issue 38
        return (
            f"Orbbec {serial} captures {kept_us} µs after the pulse instead of {delay_us} µs: the lasers of "
            f"both sensors may disturb each other. Update its firmware."
        )
    return ""
