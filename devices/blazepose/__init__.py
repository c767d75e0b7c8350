"""The program's own body tracker: BlazePose on infrared or colour images, lifted to space with depth."""

from devices.blazepose.blazepose import BlazePose
from devices.blazepose.settings import BlazePoseSettings
from devices.blazepose.tracked_images import TrackedImages

__all__ = ["BlazePose", "BlazePoseSettings", "TrackedImages"]
