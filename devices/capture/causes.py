"""Why a live sensor gives no frames, too few or late ones: how the program tells, and what it says.

The SDKs seldom give a reason. Each cause has a sign that tells it from the others, and a message that names
the cause and the way out.
"""

from __future__ import annotations

from enum import Enum

from devices.sensor import DeviceError


class Cause(Enum):
    """A cause: its sign, and its message with fields in braces."""

    # Opening
    BUSY = (
        "opening fails, and no other sign is there",
        "it is busy or starting up{said}. Close other programs that use it ({programs}), wait 5 s, try "
        "again.",
    )
    FORBIDDEN = ("this user may not write its device file", "no permission for {node}{said}. {advice}")
    OLD_FIRMWARE = (
        "libk4a logs that its firmware is not current enough",
        "its firmware {version} is older than libk4a needs. Update it with AzureKinectFirmwareTool.",
    )
    COLOR_NOT_STARTED = (
        "libk4a logs that the colour camera failed",
        "{label} did not start its colour camera. Close other programs that use the camera; unplug the "
        "sensor and plug it in again.",
    )
    ENGINE_NOT_STARTED = (
        "libk4a logs that its depth engine failed",
        "{label} did not start its cameras: the depth engine failed. On Linux it needs libdepthengine and "
        "OpenGL with an X display: k4aviewer must show its depth.",
    )
    CAMERAS_NOT_STARTED = (
        "starting fails, and libk4a does not log why",
        "{label} {what}{said}. {advice}Check that no other program keeps it busy ({programs}), its "
        "USB 3 port and power supply (two sensors need two USB controllers), and on Linux that OpenGL is "
        "there: {programs} must show its depth.",
    )
    # Frames stop
    UNPLUGGED = (
        "frames stop, and the system's USB list or the SDK's count lacks it",
        "{label} was unplugged or lost its power. Plug it in again.",
    )
    IT_OR_MASTER_UNPLUGGED = (
        "the same of a subordinate, where the SDK only counts: its master may be the one that is missing",
        "{label} stopped: it, or the master on its sync cable, was unplugged or lost its power. Plug it in "
        "again.",
    )
    NO_DEPTH = (
        "no depth image, though it is connected",
        "{label} stalls: no depth for {seconds:.0f} s. Check its "
        "USB 3 port and power supply; two sensors need two USB controllers.",
    )
    NO_PULSES = (
        "the same of a subordinate",
        "{label} stalls: no depth for {seconds:.0f} s on the sync cable. {advice}",
    )
    ONLY_COLOR = (
        "other images of it come, but no depth image",
        "{label} stalls: colour comes, but no depth for {seconds:.0f} s. {advice}",
    )
    STOPPED = (
        "the SDK reports a failure, though it is connected",
        "{label} stopped giving frames{said}. Unplug it and plug it in again.",
    )
    SILENT = (
        "no frame, and nothing that it is known to wait for",
        "{label} stalls: no frame for {seconds:g} s. Check its cable and power.",
    )
    WAITING = (
        "no frame, while the tracker has images to work on, or a subordinate's cameras no pulse",
        "{label} stalls: no frame for {seconds:g} s, because it waits for {waits_for}.",
    )
    # The body tracker
    TRACKER_STALLS = (
        "no result, or no room for a capture, within its time limit",
        "The body tracker stalls: it {what} for {seconds:g} s. Its GPU is too slow or busy: close other "
        "programs, or record now and track later (duplex fuse a.mkv b.mkv).",
    )
    TRACKER_FAILED = (
        "an error of the tracker after its first result",
        "The body tracker failed (status {status}). It must be started again; if it fails at once, the GPU "
        "is out of memory or its driver was reset: close other programs, or use processing cpu.",
    )
    CAPTURE_REFUSED = (
        "an error for a capture before the first result",
        "The body tracker refused a capture (status {status}). It needs depth and infrared of one libk4a: "
        "install pyk4a built on the same SDK as libk4abt, not pyk4a-bundle.",
    )
    # Frames are missing
    LOST_ON_USB = (
        "a gap in the sensor's times, though this program emptied the SDK's queue in time",
        "{count} frames of {label} were lost on USB in {seconds:g} s (limit {most}). Give it a USB "
        "controller of its own.",
    )
    TOO_FAST = (
        "the SDK's queue was full, or the reader's",
        "{count} frames of {label} came too fast for this machine in {seconds:g} s (limit {most}). Close "
        "other programs.",
    )
    LATE = (
        "its frames come more than 0.1 s later after their capture than the other sensor's",
        "The frames of {label} come {late_ms:.0f} ms later than those of {other}, which wait for them. Its "
        "network, its USB controller or its tracker is slower.",
    )
    TOO_LATE = (
        "the same, by more than a frame waits for its partner",
        "The frames of {label} come {late_ms:.0f} ms later than those of {other}: too late for pairs. Its "
        "network, its USB controller or its tracker is slower.",
    )
    # Closing
    CLOSES_LATER = (
        "closing takes long, and it is known what it waits for",
        "{label} does not close yet: it waits for {waits_for}. It closes by itself after that.",
    )
    LEFT_BEHIND = (
        "closing takes long, and nothing explains it",
        "{label} does not close; it is left behind. Unplug it before using it again.",
    )

    def says(self, **fields: object) -> str:
        """The message with its fields filled in."""
        return self.value[1].format(**fields)

    def error(self, **fields: object) -> DeviceError:
        """The message as an error."""
        return DeviceError(self.says(**fields))


def in_brackets(fault: object) -> str:
    """The SDK's own words in brackets, with a space before; empty if it gives none."""
    return f" ({fault})" if str(fault) else ""
