"""Whether S* is as certain as it says: ``python -m tests.benchmarks.certainty FOLDER…``.

Each folder has the recordings ``a.csv`` and ``b.csv`` of two real sensors. They have no ground truth: S* is
compared with S* of less data. Labelled steps of a laboratory (gaitkit) follow, and live sessions of two Azure
Kinects on a simulated USB bus (``../shared/rig``), each if it is installed. The figures are written to
``results/certainty.json``; those of simulated sessions are in :mod:`tests.benchmarks.coverage`.
"""

import argparse
import json
import re
import sys
import tempfile
from collections import defaultdict
from itertools import combinations
from math import hypot
from pathlib import Path

import numpy as np
import pytest

from devices.events import spells_of
from devices.pairing import clock_by_motion, pair_views
from devices.recorded.two_recordings import RecordingChoice, TwoRecordings, read_two
from fusion.body import AZURE_KINECT
from fusion.joint_kinds import kind_of
from fusion.setup import FuserSettings
from recordings.fusing.files import fuse_read
from recordings.gait.events import find_gait
from recordings.session import Session
from tests.benchmarks import results
from tests.helpers.footfalls import laboratory_walk
from tests.helpers.rig import built_rig
from tests.scenarios import program

_LIMBS = {
    f"{side} {limb}".lower(): [f"{joint}{side}" for joint in joints]
    for side in ("Left", "Right")
    for limb, joints in {
        "arm": ("Elbow", "Wrist", "Hand", "HandTip", "Thumb"),
        "leg": ("Knee", "Ankle", "Foot"),
    }.items()
}
_JUDGED = ("elbow", "wrist", "knee", "ankle")
_PAIRED = [f"{joint}{side}" for joint in ("Shoulder", "Hip", *_JUDGED) for side in ("Left", "Right")]
_WINDOWS, _WINDOW_NS, _BETWEEN_NS = 12, 500_000_000, 2_000_000_000  # in which a limb is deleted
_AGREE = 0.06  # metres between the views of every joint of the limb
_ELSEWHERE = 0.1  # metres
_WITHIN = 2.5  # stated standard deviations
_DIFFERENT = 0.02  # metres: less does not tell which view S* follows
_PIECE_NS = 20_000_000_000  # the shortest in which a clock's offset is found
_OFFSETS_NS = (170_000_000, -850_000_000, 2_300_000_000)
_SAME_STEP = 0.25  # seconds between an event and its label
_LATENCY_MS, _LATER_MS = 25, (20, 100)  # of the depth images of the rig; how much later those of B come
_BETTER = 0.8  # of the views' distance


def fused(body, a, b):
    """S* of two views as ``duplex fuse`` makes it; their clocks are read as they are."""
    read = TwoRecordings(body, pair_views(body, a, b), (None, None), ())
    return Session.of(*fuse_read(read, ("a", "b"), FuserSettings(hindsight="labels"), force=True))


def joints_of(body, names):
    """Indices of those joints that the body has."""
    return [joint for name in names if (joint := body.find(name)) is not None]


def without(view, joints, windows):
    """A view whose joints (indices) are not reported in windows [(first, last)], nanoseconds."""
    positions, states = view.positions.copy(), view.states.copy()
    for of_window, (first, last) in zip(joints, windows, strict=True):
        frames = np.flatnonzero((view.time_ns >= first) & (view.time_ns <= last))
        positions[np.ix_(frames, of_window)] = np.nan
        states[np.ix_(frames, of_window)] = 0
    return view._replace(positions=positions, states=states)


def deleted_limbs(body, views, clean, random):
    """Compares S* without a limb with S* of all data. The limb is deleted where both views agree on it.

    Returns:
        For a limb deleted from ``one`` view and from ``both``: (N, 3) metres of the limb's joints, which are
        the distance between both S*, σ without the limb, and σ of all data.
    """
    near = np.linalg.norm(clean.b_in_a - clean.rows.positions_a, axis=2) < _AGREE
    on_a = clean.rows.clock_a
    joints, judged, windows = [], [], []
    for number, names in enumerate(_LIMBS.values()):
        of_limb = joints_of(body, names)
        of_limb_judged = [k for k in of_limb if kind_of(body.joints[k]) in _JUDGED]
        agree = near[:, of_limb_judged].all(axis=1) & (on_a > 0)
        for first in random.permutation(np.flatnonzero(agree)):
            within = (on_a >= on_a[first]) & (on_a <= on_a[first] + _WINDOW_NS)
            apart = all(abs(on_a[first] - other) > _BETWEEN_NS for other, _ in windows)
            late = clean.time_ns[first] > _BETWEEN_NS and on_a[first] + _WINDOW_NS < on_a.max()
            if late and apart and agree[within].mean() >= 0.9:
                joints.append(of_limb)
                judged.append(of_limb_judged)
                windows.append((int(on_a[first]), int(on_a[first]) + _WINDOW_NS))
            if len(windows) >= (number + 1) * _WINDOWS // len(_LIMBS):
                break
    found = {}
    for kind in ("one", "both"):
        chosen = (random.integers(2),) if kind == "one" else (0, 1)
        cut = [without(view, joints, windows) if k in chosen else view for k, view in enumerate(views)]
        less = fused(body, *cut)
        rows = []
        for of_window, (first, last) in zip(judged, windows, strict=True):
            at = (less.time_ns + (on_a[on_a > 0][0] - clean.time_ns[on_a > 0][0])).astype(np.int64)
            seconds = less.time[(at >= first) & (at <= last)]
            apart = np.linalg.norm(less.at(seconds) - clean.at(seconds), axis=2)[:, of_window]
            sigma, before = (of.sigma_at(seconds)[:, of_window] for of in (less, clean))
            rows.append(np.stack([apart, sigma, before], axis=-1).reshape(-1, 3))
        rows = np.concatenate([np.zeros((0, 3)), *rows])
        found[kind] = rows[np.isfinite(rows).all(axis=1)]
    return found


def limb_figures(rows):
    """Rms distance over rms deviation added, share within 2.5 deviations, 95 % of the distance in metres."""
    apart, sigma, before = rows.T
    added = float(np.mean(sigma**2 - before**2))  # negative where the whole view counts less, without a limb
    return {
        "rms_over_added": float(np.sqrt(np.mean(apart**2) / added)) if added > 0.0 else np.nan,
        "within": float(np.mean(apart <= _WITHIN * sigma)),
        "apart_95": float(np.quantile(apart, 0.95)),
    }


def thinned(body, views, clean):
    """How S* differs without a tenth of B's frames.

    Returns:
        ``elsewhere``: the share of joints that are more than 100 mm away. ``unsaid``: the share that is also
        more than 2.5 of the stated deviations away.
    """
    a, b = views
    less = fused(body, a, b.chosen(np.flatnonzero(np.arange(len(b.time_ns)) % 10 != 5)))
    seconds = clean.time[clean.time_ns <= less.time_ns[-1]]
    apart, sigma = np.linalg.norm(less.at(seconds) - clean.at(seconds), axis=2), clean.sigma_at(seconds)
    known = np.isfinite(apart) & np.isfinite(sigma)
    elsewhere = apart[known] > _ELSEWHERE
    return {
        "elsewhere": float(elsewhere.mean()),
        "unsaid": float((elsewhere & (apart[known] > _WITHIN * sigma[known])).mean()),
    }


def true_words(body, session):
    """Whether S* does what an event says, for each frame of that event.

    Returns:
        ``exchanged``: S* is nearer to the view with left and right exchanged. ``follows``: the limb of S* is
        nearer to the other view.
    """
    views = {"a": session.rows.positions_a, "b": session.b_in_a}
    spells = defaultdict(lambda: np.zeros(len(session), dtype=bool))
    for spell in spells_of(session.events):
        end = spell.end.frame if spell.end else len(session)
        spells[spell.start.topic][spell.start.frame : end] = True

    def distance(view, joints):
        apart = np.linalg.norm(session.fused[:, joints] - view[:, joints], axis=2)
        known = np.isfinite(apart).sum(axis=1)
        return np.nansum(apart, axis=1) / np.where(known, known, np.nan)

    told = {"exchanged": [], "follows": []}
    paired = joints_of(body, _PAIRED)
    for name, view in views.items():
        reported, corrected = distance(view, paired), distance(view[:, body.mirror], paired)
        said = spells[f"exchanged_{name}"] & (np.abs(reported - corrected) > _DIFFERENT)
        told["exchanged"].append((corrected < reported)[said])
        other = "b" if name == "a" else "a"
        right = np.where(
            spells[f"exchanged_{other}"][:, None, None], views[other][:, body.mirror], views[other]
        )
        for limb, names in _LIMBS.items():
            joints = joints_of(body, names)
            own, others = distance(view, joints), distance(right, joints)
            said = spells[f"lost_{name}_{limb.replace(' ', '_')}"] & (np.abs(own - others) > _DIFFERENT)
            told["follows"].append((others < own)[said])
    return {name: np.concatenate(of) for name, of in told.items()}


def clock_pieces(body, views):
    """For pieces of 20 s with a known offset: ``right``, ``wrong``, or ``none`` though it would help."""
    found = []
    firsts = range(int(views[0].time_ns[0]), int(views[0].time_ns[-1]) - _PIECE_NS + 1, _PIECE_NS)
    for first, offset in zip(firsts, _OFFSETS_NS, strict=False):
        one, other = (
            of.chosen(np.flatnonzero((of.time_ns >= first) & (of.time_ns < first + _PIECE_NS)))
            for of in views
        )
        other = other._replace(time_ns=other.time_ns - offset)
        clock = clock_by_motion(body, one, other)
        frame = float(np.median(np.diff(one.time_ns)))
        if clock is not None:
            wrong = np.abs(clock.at(other.time_ns) - offset).max()
            found.append("right" if wrong < max(frame, _WITHIN * clock.sd_ns) else "wrong")
        else:
            moved = other._replace(time_ns=other.time_ns + offset)
            apart = [np.nanmedian(fused(body, one, b).rows.disagreement) for b in (other, moved)]
            found.append("none" if apart[1] < _BETTER * apart[0] else "right")
    return found


def set_up_of(name):
    """The set-up and the person of a recording, without what the person does."""
    return re.sub(r"(stationary|steps|walk|squats\d*)", "", name)


def rotations_apart(registrations):
    """Angles between the rotations of recordings of one set-up, radians, and over their deviation."""
    pairs = [pair for of in registrations.values() for pair in combinations(of, 2)]
    angles = np.array([x.a_from_b.angle_to(y.a_from_b) for x, y in pairs])
    stated = np.array([hypot(x.rotation_sd, y.rotation_sd) for x, y in pairs])
    return {
        "pairs": len(pairs),
        "median": float(np.median(angles)),
        "within": float(np.mean(angles <= _WITHIN * stated)),
    }


def of_real(folders):
    """All figures of real recordings, by body."""
    by_body = defaultdict(list)
    for folder in folders:
        read = read_two(*(RecordingChoice(folder / f"{side}.csv") for side in "ab"))
        by_body[read.body.name].append((folder.name, read))
    return {name: of_recordings(recordings) for name, recordings in by_body.items()}


def of_recordings(recordings):
    """All figures of real recordings of one body: pairs of a name and what was read."""
    deleted, words, clocks = defaultdict(list), defaultdict(list), []
    registrations, rows = defaultdict(list), []
    for number, (name, read) in enumerate(recordings):
        body, views = read.body, read.pairing.pairs.skeletons.views
        clean = fused(body, *views)
        *_, (setup, _) = clean.setups()
        registrations[set_up_of(name)].append(setup.calibration.registration)
        rows.append(thinned(body, views, clean))
        for kind, of_kind in deleted_limbs(body, views, clean, np.random.default_rng(number)).items():
            deleted[kind].append(of_kind)
        for kind, of_words in true_words(body, clean).items():
            words[kind].append(of_words)
        clocks += clock_pieces(body, views)
        print(name, rows[-1], file=sys.stderr)
    return {
        "deleted": {kind: limb_figures(np.concatenate(of)) for kind, of in deleted.items()},
        "thinned": {name: float(np.mean([row[name] for row in rows])) for name in ("elsewhere", "unsaid")},
        "words": {kind: share(np.concatenate(of)) for kind, of in words.items()},
        "clocks": {word: clocks.count(word) for word in ("right", "wrong", "none")},
        "one_set_up": rotations_apart(registrations),
    }


def share(of):
    """Computes the share of True among Booleans; NaN if there are none."""
    return float(np.mean(of)) if len(of) else np.nan


def of_laboratory():
    """Labelled steps of a walk of a person with Parkinson's disease: found, invented and seconds late."""
    seconds, joints, labelled = laboratory_walk()
    gait = find_gait(AZURE_KINECT, np.rint(1e9 * seconds).astype(np.int64), joints, (0.0, 1.0, 0.0))
    row = {}
    for number, kind in enumerate(("heel_strike", "toe_off")):
        late, invented = [], 0
        for side, told in labelled.items():
            found = np.array([time for time, event in gait.events if event == f"{kind}_{side}"])
            off = found[:, None] - told[number]
            nearest = np.abs(off).argmin(axis=1)
            near = np.abs(off[np.arange(len(found)), nearest]) < _SAME_STEP
            late += off[np.arange(len(found)), nearest][near].tolist()
            invented += int((~near).sum())
        row[kind] = {
            "labelled": sum(len(told[number]) for told in labelled.values()),
            "found": len(late),
            "invented": invented,
            "late": float(np.mean(late)),
        }
    return row


def of_cable(rig):
    """Share of the frames of two Kinects on a cable that are paired, by how many ms B comes later."""
    row = {}
    for later in _LATER_MS:
        with tempfile.TemporaryDirectory() as folder:
            report = Path(folder) / "r.json"
            command = ["live", "--no-viewer", "--seconds", "10", "--principal", "000001111111"]
            command += ["--k4abt", str(rig / "lib" / "libk4abt.so.1.1"), "--report", str(report)]
            conf = {"a.jack": 2, "b.jack": 1, "b.depth_latency_ms": _LATENCY_MS + later}
            done = program.run(command, Path(folder), conf, (), rig)
            if done.code:
                raise RuntimeError(done.said)
            told = json.loads(report.read_text(encoding="utf-8"))
        row[str(later)] = told["paired"] / max(told["frames"]["a"], told["frames"]["b"])
    return row


def main(arguments=None):
    """Measures the recordings."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--shared", type=Path, default=Path("../shared"), help="the folder with the rig")
    options = parser.parse_args(arguments)
    figures = {"real": of_real(options.folders)}
    # the folders may lie anywhere: the written command names them without their path
    sys.argv[1:] = [Path(argument).name for argument in sys.argv[1:]]
    for name, measure in (
        ("laboratory", of_laboratory),
        ("cable", lambda: of_cable(built_rig(options.shared))),
    ):
        try:
            figures[name] = measure()
        except pytest.skip.Exception as missing:
            print(missing, file=sys.stderr)
    results.write("certainty", figures)


if __name__ == "__main__":
    main()
