"""The offline loop: fuse each pair and pass it to the sink."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
from rich.console import Console

from devices.depth import witness as depth_witness
from fusion.fuser import Fuser
from recordings.images.rvl import encode_depth


def warm_up(fuser: Fuser, console: Console, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Compiles the kernels before the first frame; prints a notice if this takes more than a second.

    Args:
        fuser: The fuser whose kernels are compiled.
        console: Receives the notice.
        meanwhile: A callable that compiles further kernels.
    """
    notice = threading.Timer(1.0, console.print, ["Compiling the kernels; only the first run does this …"])
    notice.daemon = True
    notice.start()
    try:
        fuser.warm_up(meanwhile)
        depth_witness.warm_up()
        encode_depth(np.zeros((1, 1), dtype=np.uint16))
    finally:
        notice.cancel()
