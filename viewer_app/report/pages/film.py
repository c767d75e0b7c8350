"""The colour images of a session as small JPEGs, which the player of a page shows at their moments."""

import io
import math
from base64 import b64encode
from collections.abc import Iterator
from contextlib import suppress

from PIL import Image

from recordings.data import layout
from recordings.session import Session

_FPS = 10.0
_WIDTH = 240  # pixels
_MOST_BYTES = 6_000
"""Of an image: 10 MB for a minute of both sensors, as text."""
_MOST = 1_200
"""Images of a sensor: two minutes. Those of a longer session are farther apart."""
_NO_IMAGE = (OSError, SyntaxError, ValueError, Image.DecompressionBombError)
"""What Pillow raises for damaged images, and for one that claims to be very large."""
_QUALITIES = (60, 40, 20, 10)  # of the JPEG, per cent


def film(session: Session) -> dict[str, list[tuple[float, str]]]:
    """Seconds and base64 of the JPEGs of each sensor with colour images, by its side, in order of time.

    An image that is damaged, or that no quality makes small enough, is left out.
    """
    step = max(math.ceil(session.frame_rate / _FPS), math.ceil(len(session) / _MOST))
    shown = {side: list(_shown(session, side, step)) for side in layout.VIEWS}
    return {side: images for side, images in shown.items() if images}


def _shown(session: Session, side: str, step: int) -> Iterator[tuple[float, str]]:
    for frame, image in session.images.color(side, range(0, len(session), step)):
        with suppress(*_NO_IMAGE):
            if small := _small(image.jpeg):
                yield round(float(session.time[frame]), 3), b64encode(small).decode()


def _small(jpeg: bytes) -> bytes:
    """A small JPEG of a JPEG; empty where none is small enough."""
    with Image.open(io.BytesIO(jpeg)) as image:
        image.draft("RGB", (_WIDTH, _WIDTH))  # decodes fewer pixels
        picture = image.convert("RGB")
    picture.thumbnail((_WIDTH, _WIDTH))
    for quality in _QUALITIES:
        out = io.BytesIO()
        picture.save(out, "JPEG", quality=quality)
        if out.tell() <= _MOST_BYTES:
            return out.getvalue()
    return b""
