"""Makes the moving picture of the README: S_A, S_B and S* side by side in two hard moments.

``python -m tests.experiments.moving_picture`` runs ``duplex demo``, draws what Kinect A, Kinect B and the
program make of the same moments in a viewer without a screen, and writes ``docs/pictures/moving.webp``.
Joints that are far from the truth are red; what a Kinect does not see is grey, where it really is. A
graphics driver or Debian's mesa-vulkan-drivers is needed.
"""

import io
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from devices.simulated.demonstration import MIRRORED, MISPLACED
from recordings import Session
from recordings.appearance.body_shape import capsule_lengths, capsule_radii, capsule_rotations, parents
from recordings.appearance.colors import SKELETON_COLORS
from recordings.appearance.floor import find_floor
from recordings.data import layout
from tests.helpers.pictures import headless_viewer
from tests.helpers.waiting import eventually
from viewer_app.cli import main

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "pictures" / "moving.webp"
LIMIT = 1_000_000
"""Bytes; a README that loads slowly is not read."""
FAR = 0.2
"""Metres from the truth from which on a joint is red."""
_QUALITIES = (80, 65, 50, 35, 20)
SHOWN = ("a", "b", "fused")
_TITLES = {"a": "Kinect A", "b": "Kinect B", "fused": "fused"}
WRONG = (255, 60, 50)
_PAPER = (17, 19, 24)
_GRID = (70, 74, 84)
_GHOST, _QUIET = (84, 88, 98), (150, 153, 160)
_EYE_M, _EYE_ABOVE_M, _EYE_TURNED = 3.1, 0.2, np.radians(24.0)
"""The eye: distance from the person, height above the pelvis, and turn from the middle between the sensors to
B, so that a lunge towards the sensors is not foreshortened."""
_BEFORE_S, _AFTER_S = 0.4, 0.6
_RATE = 16.0
"""Pictures per second."""
_THIRD = (260, 420)
"""Width and height of each skeleton's picture, pixels."""
_FLOOR_M, _MESH_M = 1.0, 0.5
_EDGE = 12  # pixels: the viewer's own frame round a view


@dataclass(frozen=True)
class Skeletons:
    """What is drawn: three skeletons over time.

    Attributes:
        positions: By the keys of ``layout.SKELETON_NAMES``, (T, J, 3) metres in K_A's frame; those of a joint
            that is not seen are the true ones.
        unseen: Of each, (T, J) whether the joint has no position.
        hidden: Of each, (T,) whether more than one joint of trunk and limbs is not seen.
        wrong: Of each, (T, J) whether the joint is far from the truth.
        exchanged: Of each, (T,) whether its wrong joints fit the truth better with left and right exchanged.
    """

    positions: dict[str, NDArray[np.float64]]
    unseen: dict[str, NDArray[np.bool_]]
    hidden: dict[str, NDArray[np.bool_]]
    wrong: dict[str, NDArray[np.bool_]]
    exchanged: dict[str, NDArray[np.bool_]]


def skeletons_of(session):
    """The three skeletons of a session, and their wrong joints."""
    rows = session.rows
    positions = {"a": rows.positions_a.astype(np.float64), "b": rows.b_in_a, "fused": rows.fused}
    truth = rows.fused if rows.truth is None else rows.truth
    off = {key: np.linalg.norm(at - truth, axis=2) for key, at in positions.items()}
    swapped = {k: np.linalg.norm(at[:, session.body.mirror] - truth, axis=2) for k, at in positions.items()}
    wrong = {key: each > FAR for key, each in off.items()}
    exchanged = {k: ((swapped[k] < off[k]) & wrong[k]).sum(1) > 0.5 * wrong[k].sum(1) for k in off}
    unseen = {key: ~np.isfinite(at).all(axis=2) for key, at in positions.items()}
    drawn = {key: np.where(unseen[key][..., None], truth, at) for key, at in positions.items()}
    bones = capsule_lengths(session.body, np.ones(len(session.body))) > 0.0  # the face has none
    hidden = {key: each[:, bones].sum(axis=1) > 1 for key, each in unseen.items()}
    return Skeletons(drawn, unseen, hidden, wrong, exchanged)


def pictures(session, skeletons, rows, size):
    """Draws the three skeletons of some frames side by side."""
    window = 3 * (size[0] + _EDGE), size[1] + 5 * _EDGE
    with headless_viewer(size=window) as viewer, tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.rrd"
        _write_scene(file, session, skeletons, rows)
        viewer.open(str(file))
        return [_drawn(viewer, k, size) for k in range(len(rows))]


def _write_scene(file, session, skeletons, rows):
    body, fused = session.body, skeletons.positions["fused"]
    floor = find_floor(body, fused[np.isfinite(fused).all(axis=(1, 2))])
    person = np.nanmedian(fused[list(rows)][:, body.root], axis=0)
    stream = rr.RecordingStream("moving_picture")
    stream.save(
        file, rrb.Blueprint(_views(session, floor, fused[list(rows)]), *_no_panels(), auto_views=False)
    )
    steps = np.arange(-_FLOOR_M, _FLOOR_M + _MESH_M, _MESH_M)
    ends = (-_FLOOR_M, _FLOOR_M)
    mesh = [[(x, 0.0, z) for z in ends] for x in steps] + [[(x, 0.0, z) for x in ends] for z in steps]
    under = floor.inverse().apply(person) * (1.0, 0.0, 1.0)
    lines = [floor.apply(np.array(line) + under) for line in mesh]
    stream.log("/floor", rr.LineStrips3D(lines, colors=_GRID, radii=0.004), static=True)
    lengths = capsule_lengths(body, np.nan_to_num(session.bone_lengths[rows[-1]]))
    for k, row in enumerate(rows):
        stream.set_time("picture", sequence=k)
        for key in SHOWN:
            at = skeletons.positions[key][row]
            known = np.isfinite(at).all(axis=1)
            unseen = skeletons.unseen[key][row]
            colors = np.tile(SKELETON_COLORS[key], (len(body), 1))
            colors[skeletons.wrong[key][row]] = color_of_fault(skeletons, key, row)
            colors[unseen | unseen[parents(body)]] = _GHOST  # a bone needs both of its ends
            capsules = rr.Capsules3D(
                lengths=lengths[known],
                radii=capsule_radii(body)[known],
                translations=at[known],
                quaternions=capsule_rotations(body, at)[known],
                colors=colors[known],
                fill_mode=rr.components.FillMode.Solid,
            )
            stream.log(f"/{key}", capsules)
    stream.disconnect()
    del stream


def _views(session, floor, fused):
    """Three views with one eye, which the whole movement is in the middle of."""
    up, person = -floor.rotation[:, 1], np.nanmedian(fused[:, session.body.root], axis=0)
    between = 0.5 * session.calibration.a_from_b.translation - person
    between -= (between @ up) * up
    between /= np.linalg.norm(between)
    across = np.cross(up, between)
    to_b = np.sign(across @ session.calibration.a_from_b.translation)
    towards = np.cos(_EYE_TURNED) * between + to_b * np.sin(_EYE_TURNED) * across
    aside = np.cross(up, towards)
    reach = (fused - person) @ aside
    person = person + 0.5 * (np.nanmin(reach) + np.nanmax(reach)) * aside
    middle = person + 0.08 * up  # room for a raised hand below the title
    controls = rrb.EyeControls3D(
        position=middle + _EYE_M * towards + _EYE_ABOVE_M * up, look_target=middle, eye_up=up
    )
    return rrb.Horizontal(
        *(
            rrb.Spatial3DView(
                origin="/", contents=[f"/{key}", "/floor"], name=key, background=_PAPER, line_grid=False,
                eye_controls=controls,
            )
            for key in SHOWN
        )
    )  # fmt: skip


def _no_panels():
    return [panel(state="hidden") for panel in (rrb.BlueprintPanel, rrb.SelectionPanel, rrb.TimePanel)]


def _drawn(viewer, k, size):
    """The three views of a picture as soon as they are drawn twice alike."""
    found = []

    def settled():
        try:
            viewer.set_time("picture", sequence=k, play_state="paused")
            names = {view.name: view.view_id for view in viewer.get_state().views}
            whole = Image.new("RGB", (3 * size[0], size[1]), _PAPER)
            for place, key in enumerate(SHOWN):
                shot = Image.open(io.BytesIO(viewer.take_screenshot(names[key]))).convert("RGB")
                middle = (shot.width - size[0]) // 2, (shot.height - size[1]) // 2
                part = shot.crop((*middle, middle[0] + size[0], middle[1] + size[1]))
                whole.paste(part, (place * size[0], 0))
        except (ConnectionError, RuntimeError, ValueError, KeyError):  # the file is not loaded yet
            return False
        alike = bool(found) and found[-1].tobytes() == whole.tobytes()
        found[:] = [whole]
        return alike and _shows_someone(whole)

    if not eventually(settled, 60.0):
        raise TimeoutError(f"The viewer does not draw picture {k}.")
    return found[-1]


def _shows_someone(picture):
    colors = np.asarray(picture, dtype=int)
    return int((colors.max(axis=2) - colors.min(axis=2) > 60).sum()) > 500


def with_captions(picture, skeletons, row):
    """The picture with the names of the three skeletons, and what is wrong with each."""
    picture = picture.copy()
    pen, width = ImageDraw.Draw(picture), picture.width // len(SHOWN)
    title, text = ImageFont.load_default(size=22), ImageFont.load_default(size=17)
    for place, key in enumerate(SHOWN):
        middle = (place + 0.5) * width
        pen.text((middle, 24), _TITLES[key], fill=SKELETON_COLORS[key], font=title, anchor="mm")
        words = fault_of(skeletons, key, row)
        color = color_of_fault(skeletons, key, row) if words else _QUIET
        if not words and key == "fused" and any(fault_of(skeletons, side, row) for side in layout.VIEWS):
            words, color = "stays right", SKELETON_COLORS[key]
        elif not words and key != "fused" and skeletons.hidden[key][row]:
            words = "grey: not seen"
        pen.text((middle, picture.height - 20), words, fill=color, font=text, anchor="mm")
        if place:
            pen.line([(place * width, 12), (place * width, picture.height - 12)], fill=_GRID)
    return picture


def color_of_fault(skeletons, key, row):
    """That of an exchanged view, as in the viewer; red for a single wrong joint."""
    return SKELETON_COLORS[f"exchanged_{key}"] if skeletons.exchanged[key][row] else WRONG


def fault_of(skeletons, key, row):
    """What is wrong with a skeleton, in a few words."""
    wrong = int(skeletons.wrong[key][row].sum())
    if wrong < 2:
        return ""
    return "left and right exchanged" if skeletons.exchanged[key][row] else "an arm is misplaced"


def write_animation(path, frames, seconds):
    """Writes an animated WebP of the best quality that stays below the limit."""
    each = round(1000 * seconds / len(frames))
    for quality in _QUALITIES:
        made = io.BytesIO()
        frames[0].save(
            made, "WEBP", save_all=True, append_images=frames[1:], duration=each, loop=0, quality=quality
        )
        if len(made.getvalue()) < LIMIT:
            path.write_bytes(made.getvalue())
            return quality
    raise ValueError(f"{len(frames)} frames of {frames[0].size} do not fit into {LIMIT} bytes.")


def run():
    """Makes the picture: one round of both faults."""
    begin, end = MIRRORED.begins - _BEFORE_S, MISPLACED.begins + MISPLACED.seconds + _AFTER_S
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "demo.rrd"
        options = ["--motion", "badminton", "--seconds", str(end + 1.0), "--depth", "none"]
        main(["demo", *options, "--no-viewer", "--quiet", "--save", str(file)])
        session = Session.open(file)
        moments = np.arange(begin, end, 1.0 / _RATE)
        rows = np.searchsorted(session.time_ns * 1e-9, moments).clip(max=len(session) - 1).tolist()
        skeletons = skeletons_of(session)
        drawn = pictures(session, skeletons, rows, _THIRD)
    frames = [with_captions(picture, skeletons, row) for picture, row in zip(drawn, rows, strict=True)]
    quality = write_animation(PICTURE, frames, end - begin)
    size = PICTURE.stat().st_size / 1e6
    print(f"{PICTURE}: {begin:.1f} to {end:.1f} s, {len(frames)} pictures, {size:.2f} MB, {quality=}")


if __name__ == "__main__":
    run()
