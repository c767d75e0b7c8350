"""The data of a session: frames, settings, calibrations, events and images, as in its file."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from datetime import datetime
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from devices.events import Event
from devices.people.recorded_people import SeenPerson
from devices.sensor import ColorImage
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.intrinsics import Intrinsics
from fusion.setup import FuserSettings, FusionSetup
from fusion.support.read_only import read_only
from recordings.data import layout
from recordings.data.images import NO_IMAGES, Images, SessionImages
from recordings.data.session_arrays import SessionArrays
from recordings.errors import RecordingError, UnknownNameError


class ViewsAgree(NamedTuple):
    """Distance of the calibrated views, metres: median and 95th percentile over frames; NaN without any.

    The distance of a frame is the median over the joints that both see.
    """

    median: float
    percentile_95: float

    @staticmethod
    def of(apart: NDArray[np.float64]) -> ViewsAgree:
        """Of the distance of each frame, metres; NaN where unknown."""
        known = apart[np.isfinite(apart)]
        if not len(known):
            return ViewsAgree(math.nan, math.nan)
        return ViewsAgree(float(np.median(known)), float(np.percentile(known, 95.0)))


_WRITTEN_ANEW = (
    *("layout_version", "written_by", "body", "method_revision", "bone_names", "source_a", "source_b"),
    *("first_frame", "made_of_damaged", "made_without_frames"),
)
"""Properties that are not copied when a session is saved, trimmed or replayed: they are written anew."""
_YEARS = range(1971, 2038)  # that seconds since 1970 tell in 31 bits
OF_DAMAGED = "it was made of a session that was not: "
"""Begins the damage of a session that is whole itself."""


@dataclass(frozen=True, eq=False, repr=False)
class SessionData:
    """What a file of a session holds, and what is written to one; see :class:`recordings.session.Session`.

    Attributes:
        path: The file; None for a session in memory.
        rows: All per-frame figures as arrays.
        settings: The settings of the fusion.
        calibrations: (first frame, calibration) pairs; the first starts at frame 0. A new fuser starts at
            each.
        intrinsics_a, intrinsics_b: Intrinsics of the depth cameras.
        sources: Names of the sensors, K_A first.
        about: All properties as written, by group and name.
        events: Events in the order of writing.
        frames_lost: Number of frames that were written but cannot be read.
        damage: Description of the damage of the file; None if it is whole.
        images: Source of the images.
    """

    path: Path | None
    rows: SessionArrays
    settings: FuserSettings
    calibrations: tuple[tuple[int, Calibration], ...]
    intrinsics_a: Intrinsics
    intrinsics_b: Intrinsics
    sources: tuple[str, str]
    about: Mapping[str, Mapping[str, Sequence[Any]]]
    events: tuple[Event, ...]
    frames_lost: int
    damage: str | None
    images: SessionImages = NO_IMAGES

    def __post_init__(self) -> None:
        rows = self.rows
        for values in (rows.bone_lengths, rows.frame, rows.time_ns, *(of for *_, of in rows.figures())):
            read_only(values)  # an edit would keep the checksums of what was recorded
        every = {group: {name: tuple(of) for name, of in own.items()} for group, own in self.about.items()}
        vars(self)["about"] = MappingProxyType({group: MappingProxyType(own) for group, own in every.items()})

    def __getstate__(self) -> dict[str, Any]:
        """The data alone: what was computed from it is computed again."""
        about = {group: dict(values) for group, values in self.about.items()}
        return {each.name: getattr(self, each.name) for each in fields(self)} | {"about": about}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self.__post_init__()

    def __len__(self) -> int:
        return len(self.rows)

    def __str__(self) -> str:
        if self.path is not None:
            return str(self.path)
        is_part = "frames" in self.about["session"]
        return f"frames {runs_of(self.numbers)} of a capture" if is_part else "the session in memory"

    @property
    def name(self) -> str:
        """The file's name."""
        return "session" if self.path is None else self.path.name

    @property
    def body(self) -> Body:
        """The body that defines the joints."""
        return self.rows.body

    @property
    def fused_checksums(self) -> NDArray[np.uint32]:
        """(T,) checksums of S* in float64; the file stores float32."""
        return self.rows.fused_checksums

    @property
    def first_frame(self) -> int:
        """The number of the first frame in the original capture; greater than 0 after a trim."""
        return int(self.about["session"].get("first_frame", [0])[0])

    @property
    def numbers(self) -> NDArray[np.int64]:
        """(T,) the numbers of the frames in the original capture."""
        runs = json.loads(self.about["session"].get("frames", ["[]"])[0])
        known = [np.arange(*run) for run in runs] or [self.first_frame + np.arange(len(self))]
        return read_only(np.concatenate(known)[: len(self)])

    @property
    def left_out(self) -> int:
        """How many frames between its first and its last one were left out on purpose."""
        return int(self.about["session"].get("left_out", [0])[0])

    @property
    def tracker(self) -> str:
        """The body tracker that found the people, such as "blazepose full"; empty if not recorded."""
        return str(self.about["session"].get("tracker", [""])[0])

    @property
    def recorded(self) -> datetime | None:
        """When the capture began; None if the session does not say."""
        said = str(self.about["session"].get("recorded", [""])[0])
        with suppress(ValueError, OverflowError, OSError):  # of another program
            return datetime.fromisoformat(said).astimezone()
        return None

    @property
    def first_unix_ns(self) -> int | None:
        """When the first frame was captured, nanoseconds since 1970 UTC; None if that is not known.

        Sensors give their first frame some tenths of a second after :attr:`recorded`, which is neglected.
        """
        if self.recorded is None or self.recorded.year not in _YEARS:
            return None
        later = float(self.about["session"].get("seconds_before", [0.0])[0])
        return round(1e3 * (self.recorded.timestamp() + later)) * 1_000_000

    @property
    def seen_people(self) -> tuple[SeenPerson, ...]:
        """Those whom the recordings show, the one followed first; empty if they show one person."""
        told = json.loads(self.about["session"].get("people", ["[]"])[0])
        return tuple(SeenPerson(tuple(each["ids"]), tuple(each["seconds"])) for each in told)

    @property
    def origin(self) -> dict[str, str | float]:
        """What the session keeps of the capture that it was made of, for a session made of this one."""
        own = self.about["session"].items()
        return {name: values[0] for name, values in own if name not in _WRITTEN_ANEW}

    @property
    def method_revision(self) -> int:
        """The revision of the method that S* was computed with (:data:`fusion.setup.REVISIONS`)."""
        return int(self.about["session"].get("method_revision", [1])[0])

    @property
    def dropped(self) -> tuple[int | None, int | None]:
        """Frames of A and B that were left out before saving; None if not recorded, as by 1.0."""
        a, b = (self.about["session"].get(f"dropped_{side}", [None])[0] for side in "ab")
        return a, b

    @property
    def frame_counts(self) -> dict[str, int]:
        """The counts of :class:`devices.pairing.Pairing`; frames dropped before saving count where known."""
        clocks = self.rows.clock_a, self.rows.clock_b
        seen_a, seen_b = (int((clock != layout.NO_FRAME).sum()) for clock in clocks)
        lost_a, lost_b = (count or 0 for count in self.dropped)
        alone_a, alone_b = (
            int(((own != layout.NO_FRAME) & (other == layout.NO_FRAME)).sum())
            for own, other in (clocks, clocks[::-1])
        )
        return {
            "frames_a": seen_a + lost_a, "frames_b": seen_b + lost_b,
            "dropped_a": lost_a, "dropped_b": lost_b,
            "alone_a": alone_a, "alone_b": alone_b,
        }  # fmt: skip

    @property
    def damage_in_words(self) -> str:
        """Why it is not whole, and how many frames are known to be lost; empty if it is whole."""
        lost = f"; at least {self.frames_lost} frames are lost" if self.frames_lost else ""
        return "" if self.damage is None else f"{self.damage}{lost}"

    @property
    def clock(self) -> dict[str, float] | None:
        """How much later B captures than it says, ``offset_ms`` and ``sd_ms``; None if unknown."""
        of = self.about["session"]
        known = {name: of[f"clock_{name}"][0] for name in ("offset_ms", "sd_ms") if f"clock_{name}" in of}
        return known or None

    @property
    def first_calibrated_frame(self) -> int | None:
        """The first frame with a calibration that is not provisional; None if all are provisional."""
        return next((first for first, one in self.calibrations if not one.provisional), None)

    @cached_property
    def views_agree(self) -> ViewsAgree:
        """How far apart the views are, over all frames since the calibration: the figure of every report."""
        return ViewsAgree.of(self.rows[self.first_compared_frame :].disagreement)

    @property
    def first_compared_frame(self) -> int:
        """The first frame at which the distance of the views counts.

        If all calibrations are provisional, that of the first one that has data.
        """
        with_data = (n for n, one in self.calibrations if one.registration is not None)
        first = self.first_calibrated_frame
        return next(with_data, len(self)) if first is None else first

    @property
    def last_setup(self) -> FusionSetup:
        """The setup of the last frame."""
        return FusionSetup(self.calibrations[-1][1], self.settings, self.intrinsics_a, self.intrinsics_b)

    def setups(self, settings: FuserSettings | None = None) -> Iterator[tuple[FusionSetup, slice]]:
        """The setup and the frames of each calibration; a new fuser starts at each.

        Args:
            settings: Settings to use; None: the session's own.
        """
        firsts = [number for number, _ in self.calibrations]
        for (first, calibration), end in zip(self.calibrations, [*firsts[1:], len(self)], strict=True):
            cameras = self.intrinsics_a, self.intrinsics_b
            yield FusionSetup(calibration, settings or self.settings, *cameras), slice(first, end)

    def depth(self, side: str, first: int = 0, end: int | None = None) -> Images[NDArray[np.uint16]]:
        """Depth images of a sensor, read on demand; damaged images are skipped and counted.

        Args:
            side: ``a`` or ``b``.
            first, end: The frames from `first` to `end`, exclusive; None: to the last frame.

        Returns:
            An iterable of frame number and (height, width) millimetres, 0 without a reading. Iteration raises
            RecordingError if the file was replaced by another session since it was opened.

        Raises:
            RecordingError: There is no such side, or no such range.
        """
        return self.images.depth(_checked_side(side), self._frames(first, end))

    def color(self, side: str, first: int = 0, end: int | None = None) -> Images[ColorImage]:
        """Colour images of a sensor; same arguments and iteration as :meth:`depth`."""
        return self.images.color(_checked_side(side), self._frames(first, end))

    def _frames(self, first: int, end: int | None) -> range:
        stop = len(self) if end is None else end
        if not 0 <= first <= stop:
            raise RecordingError(f"There are no frames from {first} to {stop}.")
        return range(first, min(stop, len(self)))


def runs_of(numbers: NDArray[np.int64], most: int = 5) -> str:
    """Increasing numbers in words, such as ``3, 10–14``; the first runs of them if there are more."""
    runs = np.split(numbers, 1 + np.flatnonzero(np.diff(numbers) > 1))
    words = [f"{run[0]}–{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs[:most]]
    return ", ".join([*words, "…"] if len(runs) > most else words)


def _checked_side(side: str) -> str:
    if side not in layout.VIEWS:
        raise UnknownNameError("sensor", side, layout.VIEWS)
    return side
