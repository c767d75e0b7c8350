"""``duplex bench real``: measures the quality of S* on recordings of real sensors without ground truth."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

from devices.files import RecordingChoice, read_two
from devices.pairing import FramePair
from fusion.body import Body
from fusion.errors import FusionError
from fusion.evaluation.faults import FAULTS, Fault, share_of_fault, with_fault
from fusion.evaluation.without_truth import FusedPair, figures_without_truth, judge_registration
from fusion.plan import plan_recording
from fusion.setup import FuserSettings
from fusion.skeleton import Skeleton, SkeletonPair, TrackingState
from recordings.fusing.recorded import fuse_segments, setups_of
from viewer_app.bench.real_tables import real_tables
from viewer_app.errors import UsageError
from viewer_app.options.bench import BenchRealOptions
from viewer_app.output_files import check_writable, whole_file

FAULTY_FRAMES = 20
FAULTY_PLACES = (0.4, 0.6, 0.8)
"""Start of each fault as a share of the recording's length; the start-up pose comes before them."""
_FEWEST_PAIRS = 120
"""Two halves of two seconds each."""


def run(options: BenchRealOptions) -> None:
    """Carries out the command.

    Raises:
        DeviceError, FusionError, UsageError: With a one-line message for the user.
    """
    console = Console()
    if options.json is not None:
        check_writable(options.json, options.force)
    recordings = recordings_of(options.paths)
    rows: dict[str, dict[str, float]] = {}
    shown = track(
        recordings.items(),
        "measuring",
        total=len(recordings),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    )
    for name, (a, b) in shown:
        read = read_two(RecordingChoice(a), RecordingChoice(b))
        skeletons = [pair.skeletons for pair in read.pairing.pairs]
        try:
            rows[name] = measure(read.body, skeletons, faults=not options.no_faults)
        except FusionError as error:
            raise UsageError(f"{name}: {error}") from None
    for table in real_tables(rows, FAULTS if not options.no_faults else ()):
        console.print(table)
    if options.json is not None:
        document = {"pairs": {name: _plain(row) for name, row in rows.items()}, "mean": _plain(mean_of(rows))}
        with whole_file(options.json) as partial:
            partial.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def recordings_of(paths: Sequence[Path]) -> dict[str, tuple[Path, Path]]:
    """Returns the pairs of recordings at the given paths, by name.

    Args:
        paths: Folders that hold two recordings ``a`` and ``b`` of one format; or two recordings.

    Raises:
        UsageError: A path is neither, or the same pair is named twice.
    """
    if not paths:
        raise UsageError("Name one or more folders with a.csv and b.csv, or two recordings.")
    if len(paths) == 2 and all(path.is_file() for path in paths):
        return {f"{paths[0].stem}, {paths[1].stem}": (paths[0], paths[1])}
    found: dict[str, tuple[Path, Path]] = {}
    for path in paths:
        if not path.is_dir():
            raise UsageError(f"No folder {path}. Name folders with a.csv and b.csv, or two recordings.")
        endings = [".csv", ".json", ".skeleton", ".mkv"]
        held = [end for end in endings if all((path / f"{side}{end}").is_file() for side in "ab")]
        if not held:
            raise UsageError(f"{path} has no two recordings a and b, such as a.csv and b.csv.")
        name = path.resolve().name
        if name in found:
            name = str(path)
        if name in found:
            raise UsageError(f"{path} is named twice.")
        found[name] = path / f"a{held[0]}", path / f"b{held[0]}"
    return found


def measure(body: Body, skeletons: Sequence[SkeletonPair], *, faults: bool) -> dict[str, float]:
    """Computes all figures of one recording, by name, in SI.

    Raises:
        FusionError: The recording is too short, or cannot be calibrated.
    """
    if len(skeletons) < _FEWEST_PAIRS:
        raise FusionError(
            f"A recording needs {_FEWEST_PAIRS} pairs or more to be judged; got {len(skeletons)}."
        )
    pair = fuse_pair(body, skeletons)
    figures = figures_without_truth(pair)
    half = len(skeletons) // 2
    learned = fuse_pair(body, skeletons[:half]).a_from_b[-1]
    held_out = judge_registration(learned, pair.a[half:], pair.b[half:])
    row = {name: float(value) for name, value in asdict(figures).items()}
    row["roughness_ratio"] = figures.roughness_ratio
    row |= {f"held_out_{name}": float(value) for name, value in asdict(held_out).items()}
    if faults:
        for fault in FAULTS:
            for side in ("a", "b"):
                row[f"{fault}_{side}"] = fault_share(pair, skeletons, fault, side)
    return row


def fuse_pair(body: Body, skeletons: Sequence[SkeletonPair]) -> FusedPair:
    """Fuses a recording as the program does with its default settings."""
    settings = FuserSettings(hindsight="labels")
    plan = plan_recording(body, skeletons, settings)
    pairs = [FramePair(None, None, pair) for pair in skeletons]
    segments = setups_of(plan, settings, (None, None))
    frames = [frame.fused for frame in fuse_segments(segments, pairs, plan.codes)]
    nowhere = np.full((len(body), 3), np.nan)

    def positions(side: str) -> NDArray[np.float64]:
        view = [getattr(pair, side) for pair in skeletons]
        return np.array([nowhere if s is None else s.positions for s in view], dtype=np.float64)

    return FusedPair(
        body,
        np.array([pair.time_ns for pair in skeletons]),
        positions("a"),
        positions("b"),
        np.array([frame.positions for frame in frames]),
        tuple(frame.a_from_b for frame in frames),
    )


def fault_share(pair: FusedPair, skeletons: Sequence[SkeletonPair], fault: Fault, side: str) -> float:
    """Computes the share of a fault in one view that reaches S*, averaged over FAULTY_PLACES."""
    view = getattr(pair, side)
    shares = []
    for place in FAULTY_PLACES:
        first = int(place * len(view))
        frames = range(first, first + FAULTY_FRAMES)
        faulty = with_fault(pair.body, view, fault, frames)
        other = fuse_pair(pair.body, _with_view(skeletons, side, faulty, frames))
        shares.append(share_of_fault(view, getattr(other, side), pair.fused, other.fused))
    known = [share for share in shares if np.isfinite(share)]
    return float(np.mean(known)) if known else np.nan


def _with_view(
    skeletons: Sequence[SkeletonPair], side: str, positions: NDArray[np.float64], frames: range
) -> list[SkeletonPair]:
    """Replaces the joints of one view in some frames.

    A joint without a position becomes tracked if it gets one.
    """
    changed = list(skeletons)
    for k in frames:
        skeleton: Skeleton | None = getattr(skeletons[k], side)
        if skeleton is None:
            continue
        states = np.where(skeleton.has_position, skeleton.states, np.uint8(TrackingState.TRACKED))
        moved = Skeleton.of(skeleton.body, positions[k], states, skeleton.time_ns)
        changed[k] = replace(skeletons[k], a=moved) if side == "a" else replace(skeletons[k], b=moved)
    return changed


def mean_of(rows: dict[str, dict[str, float]]) -> dict[str, float]:
    """Computes the mean of each figure over the recordings that have it."""
    names = dict.fromkeys(name for row in rows.values() for name in row)
    known = {name: [row[name] for row in rows.values() if np.isfinite(row[name])] for name in names}
    return {name: float(np.mean(values)) if values else np.nan for name, values in known.items()}


def _plain(row: dict[str, float]) -> dict[str, Any]:
    return {name: value if np.isfinite(value) else None for name, value in row.items()}
