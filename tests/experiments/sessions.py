"""Damages a session at random, many times, and reads it back.

The whole of it: ``python -m tests.experiments.sessions --count 2000``.

Each reading must give one line of error, or exactly the first frames of what was written. The readings run in
processes of their own, so that one that crashes or hangs is found and not suffered.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import fields
from pathlib import Path

import numpy as np

from fusion.body import KINECT_V1
from recordings import layout
from recordings.errors import RecordingError
from recordings.session import Session
from recordings.session_arrays import SessionArrays
from tests.helpers.frame_pairs import frame_pairs
from tests.helpers.fused_runs import record_fused
from tests.helpers.two_views import calibration_of

BATCH = 50
SECONDS_EACH = 10.0


def make_session(path: Path) -> Session:
    """A small session with all there is: gaps, lost sensors, events, depth; written in several blocks."""
    pairs = frame_pairs(KINECT_V1, 40, gap=(7,), only_a=(9, 10), no_b=(15,), depth=True)
    return record_fused(path, pairs, calibration_of(KINECT_V1), depth_every=1, block=8)


def damaged(whole: bytes, seed: int) -> bytes:
    """Cut off, or with bits flipped, bytes changed, a stretch zeroed, or torn out."""
    rng = np.random.default_rng(seed)
    data = bytearray(whole)
    offset = int(rng.integers(len(data)))
    match seed % 6:
        case 0:
            del data[offset:]
        case 1:
            data[offset] ^= 1 << int(rng.integers(8))
        case 2:
            for k in rng.integers(len(data), size=int(rng.integers(2, 40))).tolist():
                data[k] = int(rng.integers(256))
        case 3:
            end = min(offset + int(rng.integers(1, 4096)), len(data))
            data[offset:end] = bytes(end - offset)
        case 4:
            del data[offset : offset + int(rng.integers(1, 2000))]
        case 5:  # the start of the file, which holds the settings
            data[int(rng.integers(min(40_000, len(data))))] = int(rng.integers(256))
    return bytes(data)


def read_back(path: Path, whole: Session) -> str:
    """How reading went; raises AssertionError where it went wrong."""
    try:
        session = Session.open(path)
    except RecordingError as error:
        check_message(error)
        return "refused"
    n = len(session)
    for field in fields(SessionArrays):
        expected = getattr(whole.rows, field.name)
        if field.name != "body" and expected is not None:
            np.testing.assert_array_equal(getattr(session.rows, field.name), expected[:n], err_msg=field.name)
    assert session.settings == whole.settings
    assert set(session.events) <= set(whole.events)
    assert session.calibration.a_from_b.rotation.tolist() == whole.calibration.a_from_b.rotation.tolist()
    assert (n == len(whole)) or session.damage is not None
    assert session.frames_lost + n <= len(whole)
    for side in layout.SIDES:
        images, found = dict(whole.depth(side)), session.depth(side)
        for frame, image in found:
            np.testing.assert_array_equal(image, images[frame])
    return "whole" if n == len(whole) else "beginning"


def check_message(error: RecordingError) -> None:
    """One line that says something."""
    assert str(error).count("\n") == 0
    assert len(str(error)) > 20


def run_batch(folder: Path, first: int, count: int) -> None:
    """Prints a line a seed."""
    whole = Session.open(folder / "whole.rrd")
    data = whole.path.read_bytes()
    path = folder / f"damaged-{first}.rrd"
    for seed in range(first, first + count):
        path.write_bytes(damaged(data, seed))
        print(seed, flush=True, end=" ")
        print(read_back(path, whole), flush=True)
    path.unlink()


def damage(count: int, folder: Path, first: int = 0) -> tuple[Counter[str], list[str]]:
    """How the readings went, and what went wrong, a line each."""
    make_session(folder / "whole.rrd")
    outcomes: Counter[str] = Counter()
    wrong: list[str] = []
    seed = first
    while seed < first + count:
        batch = min(BATCH, first + count - seed)
        command = [
            sys.executable,
            "-m",
            "tests.experiments.sessions",
            "--batch",
            str(folder),
            str(seed),
            str(batch),
        ]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=SECONDS_EACH * batch, check=False
            )
            lines, said = done.stdout.split("\n"), done.stderr
            code: int | str = done.returncode
        except subprocess.TimeoutExpired as expired:
            lines, said, code = (expired.stdout or b"").decode().split("\n"), "", "hang"
        finished = [line.split()[1] for line in lines if len(line.split()) == 2]
        outcomes.update(finished)
        seed += len(finished)
        if code != 0:
            wrong.append(f"seed {seed}: {code}: {said.strip()[-300:]}")
            seed += 1
    return outcomes, wrong


def main() -> None:
    """Damages sessions as the options say, and prints what became of them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--batch", nargs=3, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.batch:
        run_batch(Path(options.batch[0]), int(options.batch[1]), int(options.batch[2]))
        return
    with tempfile.TemporaryDirectory() as folder:
        outcomes, wrong = damage(options.count, Path(folder), options.first)
    print(*(f"{n} {how}" for how, n in outcomes.most_common()), sep=", ")
    print(*wrong, sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
