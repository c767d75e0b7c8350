"""Applies motion capture from a BVH file to the segments of the simulated person.

The directions of the segments come from the file. The lengths of the limbs are those of the simulated person,
so that the bone lengths of all bodies are exact for any spine and collars in the file. Joints that
motion capture lacks (hand tips, thumbs, nose, eyes, ears) are fixed to their segments.
"""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from devices.check import extra_command
from devices.input_file import input_text
from devices.sensor import DeviceError
from devices.simulated.person import anatomy
from devices.simulated.person.anatomy import Pose, along, length, offset, unit
from devices.simulated.person.footsteps import smooth
from devices.simulated.person.motion import STARTUP_SECONDS
from devices.simulated.person.movements import MOTIONS
from fusion.support.types import Array

_BLEND_SECONDS = 1.5
BEGINS = STARTUP_SECONDS + _BLEND_SECONDS
"""Start of the captured movement, after the start-up pose, seconds."""

# Required joints, by their names in common rigs (CMU, Mixamo, Rokoko, Xsens), in order of preference.
_NAMES = {"root": ("hips", "hip", "pelvis", "root"), "neck": ("neck", "neck1"), "head": ("head",)}
_SIDED_NAMES = {
    "shoulder": ("shldr", "arm", "upperarm", "uparm", "shoulder"),
    "elbow": ("forearm", "elbow", "lowerarm", "lowarm"),
    "wrist": ("hand", "wrist"),
    "hip": ("thigh", "upleg", "upperleg", "hip"),
    "knee": ("shin", "leg", "lowerleg", "lowleg", "knee"),
    "ankle": ("foot", "ankle"),
}
_OPTIONAL = {
    "finger": ("mid1", "middle1", "handmiddle1", "handindex1", "index1"),
    "thumb": ("thumb2", "thumb1", "handthumb2", "handthumb1", "thumb"),
}


@dataclass(frozen=True, eq=False)
class CapturedMotion:
    """The joints of a captured person as a function of time; after the end of the file they stand still."""

    name: str
    seconds: float  # duration, including the start-up pose
    _pelvis: CubicSpline
    _axes: CubicSpline

    def landmarks(self, times: ArrayLike, height: float = anatomy.REFERENCE_HEIGHT) -> Array:
        """Returns (T, N, 3) all landmarks in the world, metres, of a person of this stature."""
        t = np.atleast_1d(np.asarray(times, dtype=np.float64))
        captured = np.clip(t - BEGINS, 0.0, self._pelvis.x[-1])
        axes = self._axes(captured).reshape(len(t), len(_AXES), 2, 3)
        pelvis = self._pelvis(captured)
        start = MOTIONS["startup"].pose(t)
        weight = smooth((t - STARTUP_SECONDS) / _BLEND_SECONDS)
        start_at = start.pelvis + self._pelvis(0.0) * (1.0, 0.0, 1.0)
        pelvis = start_at * (1.0 - weight[:, None]) + pelvis * weight[:, None]
        at_start = np.stack([start.rotations[s][:, :, 1:].transpose(0, 2, 1) for s in _AXES], axis=1)
        axes = at_start * (1.0 - weight[:, None, None, None]) + axes * weight[:, None, None, None]
        rotations = {s: along(axes[:, k, 0], axes[:, k, 1]) for k, s in enumerate(_AXES)}
        marks = Pose(pelvis, rotations).landmarks()
        return marks * (height / anatomy.REFERENCE_HEIGHT)


_AXES = anatomy.SEGMENTS


def read_bvh(path: Path) -> CapturedMotion:
    """Reads a movement from a BVH file (y up, facing z); the start-up pose precedes it.

    The file may use any unit: it is scaled so that its legs match those of the simulated person.

    Raises:
        DeviceError: The file cannot be read, or its skeleton lacks a required joint.
    """
    skeleton = _read(path)
    frames, middle = _segments(skeleton, path)
    axes = np.stack([np.stack(frames[s], axis=1) for s in _AXES], axis=1)
    first = _first_frame(axes)
    axes, middle = axes[first:], middle[first:]
    frames = {segment: (y[first:], z[first:]) for segment, (y, z) in frames.items()}
    # At first the person faces the middle between the sensors. The centre of the path is the world's origin.
    ahead = -along(*frames["pelvis"])[0, :, 2]
    back = anatomy.turn(np.array([-np.arctan2(ahead[0], -ahead[2])]))[0]
    axes, middle = axes @ back.T, middle @ back.T
    middle -= 0.5 * (middle.min(axis=0) + middle.max(axis=0)) * (1.0, 0.0, 1.0)
    rotations = {s: along(axes[:, k, 0], axes[:, k, 1]) for k, s in enumerate(_AXES)}
    # Place our pelvis at the file's hips, because the file's root may lie anywhere near them.
    pelvis = middle - rotations["pelvis"] @ (0.5 * (offset("HIP_LEFT") + offset("HIP_RIGHT")))
    lowest = Pose(pelvis, rotations).landmarks()[:, _TOES, 1].max(axis=1)
    pelvis[:, 1] -= np.percentile(lowest, 95) + anatomy.FOOT_HEIGHT
    t = np.arange(len(pelvis)) * skeleton.frame_seconds
    splines = CubicSpline(t, pelvis), CubicSpline(t, axes.reshape(len(t), -1))
    return CapturedMotion(path.stem, float(t[-1]) + BEGINS, *splines)


_TOES = [anatomy.INDEX["FOOT_LEFT"], anatomy.INDEX["FOOT_RIGHT"]]


def _first_frame(axes: Array) -> int:
    """Returns the first frame of the movement, after the rest pose in which many files begin."""
    changes = np.abs(np.diff(axes, axis=0)).mean(axis=(1, 2, 3))
    jumps = changes[:10] > 3.0 * np.percentile(changes, 90)
    return int(np.argmin(jumps)) if not jumps.all() else 0


@dataclass(frozen=True, eq=False)
class _Captured:
    """A file's skeleton in our axes (y down): per joint (T, 3) positions, (T, 3, 3) rotations, and ends."""

    positions: dict[str, Array]
    rotations: dict[str, Array]
    ends: dict[str, Array]  # position of the first child, or of the end site
    frame_seconds: float


def _read(path: Path) -> _Captured:
    try:
        import bvhio
    except ImportError as error:
        raise DeviceError(f"Reading {path} needs bvhio: {extra_command('mocap')}.") from error
    try:
        _check_whole(input_text(path))
        container = bvhio.readAsBvh(str(path))
    except Exception as error:  # the parser raises errors of many types
        raise DeviceError(
            f"{path} cannot be read as BVH: {str(error)[:200]}. Choose another file."
        ) from error
    if container.FrameCount < 4:
        raise DeviceError(f"{path} has {container.FrameCount} frames; a movement needs at least 4.")
    if not 0.0 < float(container.FrameTime) < 1.0:
        raise DeviceError(f"{path} has {container.FrameTime} s per frame; it must be above 0 and below 1.")
    found = _Captured({}, {}, {}, float(container.FrameTime))
    ours = np.array((1.0, -1.0, -1.0))  # y up, left +x, front +z → y down, left +x, front −z

    def visit(joint: Any, at: Array, turned: Array) -> None:
        local = np.array([tuple(key.Position) for key in joint.Keyframes]) * ours
        quaternions = np.array([tuple(key.Rotation) for key in joint.Keyframes])  # w, x, y, z
        if not (np.isfinite(local).all() and np.isfinite(quaternions).all()):
            raise DeviceError(f"{path} has values of {joint.Name} that are not finite. Choose another file.")
        rotation = Rotation.from_quat(quaternions[:, (1, 2, 3, 0)]).as_matrix() * np.outer(ours, ours)
        at = at + np.einsum("tij,tj->ti", turned, local)
        turned = turned @ rotation
        name = re.sub(r"[^a-z0-9]", "", joint.Name.rpartition(":")[2].lower())
        found.positions[name], found.rotations[name] = at, turned
        for child in joint.Children:
            visit(child, at, turned)
        first = joint.Children[0].Offset if joint.Children else joint.EndSite
        if first is not None:
            end = getattr(first, "Offset", first)
            found.ends[name] = at + turned @ (np.array(tuple(end), dtype=np.float64) * ours)

    count = container.FrameCount
    visit(container.Root, np.zeros((count, 3)), np.tile(np.eye(3), (count, 1, 1)))
    return found


def _check_whole(text: str) -> None:
    """Rejects a file that is cut off, because bvhio would wait forever for its missing part."""
    skeleton, _, motion = text.partition("MOTION")
    if not skeleton.strip() or skeleton.count("{") != skeleton.count("}"):
        raise ValueError("its skeleton is cut off")
    count = re.search(r"Frames:\s*(\d+)\s*\n\s*Frame Time:[^\n]*\n", motion)
    if count is None or len(motion[count.end() :].splitlines()) < int(count[1]):
        raise ValueError("its frames are cut off")


def _segments(skeleton: _Captured, path: Path) -> tuple[dict[str, tuple[Array, Array]], Array]:
    """Returns the long axis and back of each segment, each (T, 3), and the hip centre, (T, 3) metres."""
    names = {key: _find(skeleton, path, key, alternatives) for key, alternatives in _NAMES.items()}
    for side, prefixes in (("LEFT", ("left", "l")), ("RIGHT", ("right", "r"))):
        for key, alternatives in (_SIDED_NAMES | _OPTIONAL).items():
            sided = tuple(prefix + name for name in alternatives for prefix in prefixes)
            if key in _SIDED_NAMES or any(name in skeleton.positions for name in sided):
                names[f"{key}_{side}"] = _find(skeleton, path, f"{side.lower()} {key}", sided)
    joint = {key: skeleton.positions[name] for key, name in names.items()}

    down, back = np.array((0.0, 1.0, 0.0)), np.array((0.0, 0.0, 1.0))
    root, head = skeleton.rotations[names["root"]], skeleton.rotations[names["head"]]
    hips = 0.5 * (joint["hip_LEFT"] + joint["hip_RIGHT"])
    legs = np.mean(
        [
            np.linalg.norm(joint[f"{upper}_{side}"] - joint[f"{lower}_{side}"], axis=1)
            for upper, lower in (("hip", "knee"), ("knee", "ankle"))
            for side in ("LEFT", "RIGHT")
        ]
    )
    scale = (length("KNEE_LEFT") + length("ANKLE_LEFT")) / float(2.0 * legs)
    pelvis_down = root @ down
    navel = hips - pelvis_down * (0.195 / scale)
    trunk_down = navel - joint["neck"]
    frames = {
        "pelvis": (pelvis_down, np.cross(joint["hip_LEFT"] - joint["hip_RIGHT"], pelvis_down)),
        "trunk": (trunk_down, np.cross(joint["shoulder_LEFT"] - joint["shoulder_RIGHT"], trunk_down)),
        "head": (head @ down, head @ back),
    }
    for side in ("LEFT", "RIGHT"):
        upper = joint[f"elbow_{side}"] - joint[f"shoulder_{side}"]
        fore = joint[f"wrist_{side}"] - joint[f"elbow_{side}"]
        hand = joint[f"finger_{side}"] - joint[f"wrist_{side}"] if f"finger_{side}" in joint else fore
        wrist = skeleton.rotations[names[f"wrist_{side}"]]
        edge = joint[f"wrist_{side}"] - joint[f"thumb_{side}"] if f"thumb_{side}" in joint else wrist @ back
        thigh, shin = (
            joint[f"knee_{side}"] - joint[f"hip_{side}"],
            joint[f"ankle_{side}"] - joint[f"knee_{side}"],
        )
        ankle = names[f"ankle_{side}"]
        toes_back = joint[f"ankle_{side}"] - skeleton.ends[ankle]
        # The slope of our ankle-to-toes line when the foot is flat.
        flat = np.cross(toes_back, np.cross(skeleton.rotations[ankle] @ down, toes_back))
        frames |= {
            f"upper_arm_{side}": (unit(upper), edge),
            f"forearm_{side}": (unit(fore), edge),
            f"hand_{side}": (unit(hand), edge),
            f"thigh_{side}": (unit(thigh), frames["pelvis"][1]),
            f"shin_{side}": (unit(shin), toes_back),
            f"foot_{side}": _level(unit(flat), unit(toes_back)),
        }
    return {
        s: (unit(y), unit(z - unit(y) * np.sum(z * unit(y), axis=1, keepdims=True)))
        for s, (y, z) in frames.items()
    }, hips * scale


def _level(down: Array, back: Array) -> tuple[Array, Array]:
    """Returns the axes of the foot from the ankle-to-toes line and its perpendicular."""
    _, drop, ahead = offset("FOOT_LEFT")
    slope = np.arctan2(drop, -ahead)
    return np.cos(slope) * down - np.sin(slope) * back, np.cos(slope) * back + np.sin(slope) * down


def _find(skeleton: _Captured, path: Path, wanted: str, names: tuple[str, ...]) -> str:
    for name in names:
        if name in skeleton.positions:
            return name
    raise DeviceError(
        f"{path} has no joint for the {wanted}. Its joints: {', '.join(skeleton.positions)}; "
        f"looked for: {', '.join(names)}."
    )
