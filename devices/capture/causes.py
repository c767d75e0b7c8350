"""Why a live sensor gives no frames, too few or late ones: how the program tells, and what it says.

The SDKs seldom give a reason. A message names the cause and the way out.
"""

from enum import Enum
from typing import Literal

from devices.sensor import DeviceError, Sensor

Origin = Literal["sensor", "network", "recording", "simulation"]
"""Where the frames of a sensor come from, and so what may be too slow."""
SLOWER: dict[Origin, str] = {
    "sensor": "Its USB controller, its colour camera (`color`) or its tracker is slower.",
    "network": "Its network or its tracker is slower.",
    "recording": "Its disk or this machine is too slow.",
    "simulation": "This machine is too slow: close other programs, or use `depth=none`.",
}
"""Why frames come late, by their origin."""
MORE_FRAMES: dict[Origin | Literal["tracker"], str] = {
    "sensor": "give {who} its own USB controller, and light",
    "network": "check the program and the network of {who}",
    "recording": "close other programs: its disk or this machine is too slow",
    "simulation": "close other programs, or use `depth=none`: this machine is too slow",
    "tracker": "close other programs: its body tracker needs more of this machine",
}
"""What to do about too few frames of a sensor, by their origin, or where the body tracker leaves out some."""


def origin_of(sensor: Sensor) -> Origin:
    """Where a sensor's frames come from."""
    if sensor.link is not None:
        return "network"
    return "simulation" if sensor.simulated else "recording" if sensor.recorded else "sensor"


class Cause(Enum):
    """A cause: its message, with fields in braces; above it the sign that tells it from the others."""

    # --- Opening
    # Opening fails, and no other sign is there.
    BUSY = (
        "it is busy or starting up{said}. Close other programs that use it ({programs}), wait 5 s, try again."
    )
    # This user may not write its device file.
    FORBIDDEN = "no permission for {node}{said}. {advice}"
    # libk4a logs that its firmware is not current enough.
    OLD_FIRMWARE = (
        "its firmware {version} is older than libk4a needs. Update it with AzureKinectFirmwareTool."
    )
    # libk4a logs that the colour camera failed.
    COLOR_NOT_STARTED = (
        "{label} did not start its colour camera. Close other programs that use the camera; unplug the "
        "sensor and plug it in again."
    )
    # libk4a logs that its depth engine failed.
    ENGINE_NOT_STARTED = (
        "{label} did not start its cameras: the depth engine failed. On Linux it needs libdepthengine and "
        "OpenGL with an X display: k4aviewer must show its depth."
    )
    # Starting fails, and libk4a does not log why.
    CAMERAS_NOT_STARTED = (
        "{label} {what}{said}. {advice}Check that no other program keeps it busy ({programs}), its "
        "USB port and power supply (two sensors need two USB controllers), and on Linux that OpenGL is "
        "there: {programs} must show its depth."
    )
    # --- Frames stop
    # Frames stop, and the system's USB list or the SDK's count lacks it.
    UNPLUGGED = "{label} was unplugged or lost its power. Plug it in again."
    # The same of a subordinate, where the SDK only counts: its master may be the one that is missing.
    IT_OR_MASTER_UNPLUGGED = (
        "{label} stopped: it, or the master on its sync cable, was unplugged or lost its power. Plug it in "
        "again."
    )
    # No depth image, though it is connected.
    NO_DEPTH = (
        "{label} stalls: no depth for {seconds:.0f} s. Check its "
        "USB port and power supply; two sensors need two USB controllers."
    )
    # The same of a subordinate.
    NO_PULSES = "{label} stalls: no depth for {seconds:.0f} s on the sync cable. {advice}"
    # Other images of it come, but no depth image.
    ONLY_COLOR = (
        "{label} stalls: colour comes, but no depth for {seconds:.0f} s. Run it without `color`, or unplug "
        "it and plug it in again."
    )
    # The SDK reports a failure, though it is connected.
    STOPPED = "{label} stopped giving frames{said}. Unplug it and plug it in again."
    # No frame, and nothing that it is known to wait for.
    SILENT = "{label} stalls: no frame for {seconds:g} s. Check its cable and power."
    # The same of a recording that is played.
    NO_MORE_RECORDED = "{label} gives no frame for {seconds:g} s: it has a gap, or its disk is slow."
    # No frame, while the tracker has images to work on, or a subordinate's cameras no pulse.
    WAITING = "{label} stalls: no frame for {seconds:g} s, because it waits for {waits_for}."
    # --- Images are missing beside depth
    # Depth comes; for two seconds no image of another kind that it is to have.
    NO_IMAGES = (
        "{label} gives no {image} images; its depth continues without them.{found} Unplug it and plug it in "
        "again{without}."
    )
    # The same, though such images come: a frame later than depth waits for them.
    LATE_IMAGES = (
        "The {image} images of {label} come {late_ms:.0f} ms later than its depth, which continues without "
        "them.{found} Give it a USB controller of its own{without}."
    )
    # Depth comes at its rate, the images at a lower one.
    FEW_IMAGES = (
        "{label} gives {rate:.3g} {image} images per second, not {fps}; its depth continues at its own rate."
        "{found} {why}{without}."
    )
    # --- The body tracker
    # No result, or no room for a capture, within its time limit.
    TRACKER_STALLS = (
        "The body tracker stalls: it {what} for {seconds:g} s. Its GPU is too slow or busy: close other "
        "programs, or record now and track later (duplex fuse a.mkv b.mkv)."
    )
    # An error of the tracker after its first result.
    TRACKER_FAILED = (
        "The body tracker failed (status {status}). It must be started again; if it fails at once, the GPU "
        "is out of memory or its driver was reset: close other programs, or use processing cpu."
    )
    # An error for a capture before the first result.
    CAPTURE_REFUSED = (
        "The body tracker refused a capture (status {status}). It needs depth and infrared of one libk4a: "
        "install pyk4a built on the same SDK as libk4abt, not pyk4a-bundle."
    )
    # --- Frames are missing
    # Its frames come more than 0.1 s later after their capture than the other sensor's.
    LATE = (
        "The frames of {label} come {late_ms:.0f} ms later than those of {other}, which wait for them. "
        "{slower}"
    )
    # On a sync cable, its images come half a frame or more later than the other sensor's of the same pulse.
    LATE_ON_CABLE = (
        "The images of {label} come {late_ms:.0f} ms later than those of {other} of the same moment, which "
        "wait for them. Its USB controller or its colour camera (`color`) is slower."
    )
    # The same, by more than a frame waits for its partner.
    TOO_LATE = (
        "The frames of {label} come {late_ms:.0f} ms later than those of {other}: too late for pairs. "
        "{slower}"
    )
    # --- Closing
    # Closing takes long, and it is known what it waits for.
    CLOSES_LATER = "{label} does not close yet: it waits for {waits_for}. It closes by itself after that."
    # Closing takes long, and nothing explains it.
    LEFT_BEHIND = "{label} does not close; it is left behind. Unplug it before using it again."
    # The same of a recording that is played.
    RECORDING_LEFT_BEHIND = "{label} does not close; it is left behind. Its disk or its body tracker hangs."

    def says(self, **fields: object) -> str:
        """The message with its fields filled in."""
        return self.value.format(**fields)

    def error(self, **fields: object) -> DeviceError:
        """The message as an error."""
        return DeviceError(self.says(**fields))


def in_brackets(fault: object) -> str:
    """The SDK's own words in brackets, with a space before; empty if it gives none."""
    return f" ({fault})" if str(fault) else ""
