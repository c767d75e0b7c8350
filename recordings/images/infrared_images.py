"""Infrared images for the viewer: compressed to what an eye can tell apart."""

from __future__ import annotations

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from devices.blazepose.grey_image import compressed
from recordings import layout

_QUALITY = 80  # of the JPEG, per cent: 20 KB for an image of 320 × 288 pixels


def show_infrared(stream: rr.RecordingStream, side: str, image: NDArray[np.uint16]) -> None:
    """Logs an infrared image as the body tracker sees it, at the stream's current time.

    Args:
        stream: The stream of a viewer. Files hold no infrared: no step after the body tracker reads it.
        side: ``a`` or ``b``.
        image: (height, width) uint16, on the pixels of the depth image.
    """
    grey = np.rint(255.0 * compressed(image)).astype(np.uint8)
    written, jpeg = cv2.imencode(".jpg", grey, (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
    if written:
        contents = jpeg.tobytes()
        stream.log(layout.infrared(side), rr.EncodedImage(contents=contents, media_type="image/jpeg"))
