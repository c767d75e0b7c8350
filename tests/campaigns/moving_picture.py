"""Makes the moving picture of the README: S_A and S_B against S* in a hard moment.

``python -m tests.campaigns.moving_picture`` runs ``duplex demo``, finds the moment in which the two views
disagree most, draws it in the viewer without a screen, and writes ``docs/pictures/moving.webp``. A session of
one's own is drawn with ``--session``. A graphics driver or Debian's mesa-vulkan-drivers is needed.
"""

from __future__ import annotations

import argparse
import io
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from numpy.typing import ArrayLike
from PIL import Image, ImageDraw, ImageFont
from rerun.experimental import ViewerClient

from fusion.setup import FusionSetup
from recordings import Session, layout
from tests.helpers.waiting import eventually
from viewer_app.cli import main
from viewer_app.viewer.blueprint import session_blueprint
from viewer_app.viewer.rerun_process import LOOPBACK, start_viewer, stop

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "moving.webp"
LIMIT = 3_000_000
"""Bytes; a README that loads slowly is not read."""
_QUALITIES = (80, 65, 50, 35, 20)
_SHOWN = ("a", "b", "fused")


def hardest_window(seconds: ArrayLike, disagreement: ArrayLike, length: float) -> tuple[float, float]:
    """Finds the stretch of time with the largest mean disagreement of the views.

    Args:
        seconds: (T,) ascending times.
        disagreement: (T,) metres; NaN where there is none.
        length: Length of the stretch, seconds; at most that of the session.

    Returns:
        Begin and end, seconds.
    """
    time, apart = np.asarray(seconds, dtype=np.float64), np.nan_to_num(np.asarray(disagreement, np.float64))
    total = np.concatenate(([0.0], np.cumsum(apart)))
    ends = np.searchsorted(time, time + length, side="right")
    whole = time + length <= time[-1] + 1e-9
    if not whole.any():
        return float(time[0]), float(time[-1])
    firsts = np.flatnonzero(whole)
    means = (total[ends[firsts]] - total[firsts]) / (ends[firsts] - firsts)
    begin = float(time[firsts[int(np.argmax(means))]])
    return begin, begin + length


def scene_of(blueprint: rrb.Blueprint) -> rrb.Spatial3DView:
    """The first three-dimensional view of the tab *inspect*."""
    tabs = blueprint.root_container
    inspect = next(tab for tab in tabs.contents if tab.name == "inspect")
    return next(view for view in _views(inspect) if isinstance(view, rrb.Spatial3DView))


def _views(container: rrb.Container | rrb.View) -> Iterator[rrb.View]:
    if isinstance(container, rrb.View):
        yield container
        return
    for content in container.contents:
        yield from _views(content)


def pictures(session: Session, moments: Sequence[float], size: tuple[int, int]) -> list[Image.Image]:
    """Draws the scene of a session at some moments.

    Args:
        session: What to draw.
        moments: Seconds of the session's timeline.
        size: Width and height of the viewer's window in pixels; the scene is lower.

    Raises:
        UsageError: There is no viewer that draws without a screen.
    """
    setup = FusionSetup(session.calibrations[-1][1], session.settings)
    fused = session.fused[np.isfinite(session.fused).all(axis=(1, 2))]
    person_at = np.median(fused.reshape(-1, 3), axis=0)
    view = scene_of(session_blueprint(setup, person_at, "inspect"))
    panels = (rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel)
    blueprint = rrb.Blueprint(view, *(panel(state="hidden") for panel in panels), auto_views=False)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.rrd"
        session.save(file, blueprint)
        process, port = start_viewer(["--headless", "--window-size", f"{size[0]}x{size[1]}", str(file)])
        try:
            viewer = ViewerClient.connect(f"rerun+http://{LOOPBACK}:{port}/proxy")
            return [_drawn(viewer, moment) for moment in moments]
        finally:
            stop(process)


def _drawn(viewer: ViewerClient, moment: float) -> Image.Image:
    """The scene at a moment, as soon as the viewer draws it twice alike: its eye glides to its place."""
    found: list[Image.Image] = []

    def settled() -> bool:
        try:
            viewer.set_time(layout.TIME, duration=moment, play_state="paused")
            view = viewer.get_state().views[0]
            picture = Image.open(io.BytesIO(viewer.take_screenshot(view.view_id))).convert("RGB")
        except (ConnectionError, RuntimeError, ValueError, IndexError):  # the file is not loaded yet
            return False
        alike = bool(found) and found[-1].tobytes() == picture.tobytes()
        found[:] = [picture]
        return alike and _shows_fused(picture)

    if not eventually(settled, 60.0):
        raise TimeoutError(f"The viewer draws no S* at {moment:g} s.")
    return found[-1]


def _shows_fused(picture: Image.Image) -> bool:
    red, green, blue = np.moveaxis(np.asarray(picture, dtype=int), 2, 0)
    return int(((blue - green > 40) & (red - green > 20)).sum()) > 50  # purple, light or dark


def with_legend(picture: Image.Image) -> Image.Image:
    """The picture with the names of the three skeletons in their colours."""
    picture = picture.copy()
    pen, x = ImageDraw.Draw(picture), 12.0
    font = ImageFont.load_default(size=18)
    for key in _SHOWN:
        text = layout.SKELETON_NAMES[key]
        pen.text((x, picture.height - 30), text, fill=layout.SKELETON_COLORS[key], font=font)
        x += pen.textlength(text, font=font) + 18
    return picture


def write_animation(path: Path, frames: Sequence[Image.Image], seconds: float, limit: int = LIMIT) -> int:
    """Writes an animated WebP of the best quality that stays below a size.

    Args:
        path: The file; overwritten.
        frames: At least two pictures of one size.
        seconds: Duration of one turn.
        limit: Bytes.

    Returns:
        The quality, 1 to 100.

    Raises:
        ValueError: No quality is low enough.
    """
    each = round(1000 * seconds / len(frames))
    for quality in _QUALITIES:
        made = io.BytesIO()
        frames[0].save(
            made, "WEBP", save_all=True, append_images=frames[1:], duration=each, loop=0, quality=quality
        )
        if len(made.getvalue()) < limit:
            path.write_bytes(made.getvalue())
            return quality
    raise ValueError(f"{len(frames)} frames of {frames[0].size} do not fit into {limit} bytes.")


def demo_session(file: Path, motion: str, seconds: float) -> Session:
    """The session of ``duplex demo``, without images."""
    options = ["--motion", motion, "--seconds", str(seconds), "--depth", "none", "--no-viewer", "--quiet"]
    main(["demo", *options, "--save", str(file), "--force"])
    return Session.open(file)


def run() -> None:
    """Makes the picture."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--session", type=Path, help="a session; without it, duplex demo is run")
    parser.add_argument("--motion", default="badminton", help="movement of the demo")
    parser.add_argument("--seconds", type=float, default=4.0, help="of the session that are shown")
    parser.add_argument("--rate", type=float, default=12.0, help="pictures per second of the session")
    parser.add_argument("--slower", type=float, default=1.5, help="how much slower than in the session")
    parser.add_argument("--size", type=int, nargs=2, default=(720, 480), help="width and height")
    parser.add_argument("--out", type=Path, default=PICTURE)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.session is None:
            session = demo_session(Path(folder) / "demo.rrd", options.motion, 20.0)
        else:
            session = Session.open(options.session)
        seconds = session.time_ns * 1e-9
        begin, end = hardest_window(seconds, session.quality.disagreement, options.seconds)
        moments = np.arange(begin, end, 1.0 / options.rate).tolist()
        frames = [with_legend(picture) for picture in pictures(session, moments, tuple(options.size))]
    quality = write_animation(options.out, frames, options.slower * (end - begin))
    size = options.out.stat().st_size
    print(
        f"{options.out}: {begin:.1f} to {end:.1f} s, {len(frames)} pictures, {size / 1e6:.2f} MB, {quality=}"
    )


if __name__ == "__main__":
    run()
