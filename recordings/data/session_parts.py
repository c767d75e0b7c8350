"""Some frames of a session as a session of its own: of a range of time, or of the seconds that are good."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from devices.arrow_numbers import numbers_of
from devices.events import Event, spells_of
from devices.sensor import ColorImage
from recordings.data import layout
from recordings.data.images import Images, SessionImages
from recordings.data.session_data import SessionData
from recordings.errors import RecordingError

S = TypeVar("S", bound=SessionData)
T = TypeVar("T")


def part_of(session: S, frames: ArrayLike | slice) -> S:
    """The session of some frames, whose numbers and times start at 0; a gap between them stays in the times.

    Its ``numbers`` are those of its frames in the original capture; its property ``seconds_before`` is when
    the first one was there. It is in memory, whatever file it comes from.

    Args:
        frames: (N,) their numbers, increasing; or (T,) flags, or a slice.

    Raises:
        RecordingError: There are none, or the session does not have them in this order.
    """
    try:
        kept = np.arange(len(session))[frames if isinstance(frames, slice) else np.asarray(frames)]
    except IndexError:
        kept = np.arange(0)
    if kept.ndim != 1 or not len(kept) or (np.diff(kept) <= 0).any():
        raise RecordingError(
            f"{session} has {len(session)} frames; a part needs some of them, in order: their numbers, or a "
            "flag for each frame."
        )
    if len(kept) == len(session):
        return session
    first, end = int(kept[0]), int(kept[-1]) + 1
    chosen = kept if end - first > len(kept) else slice(first, end)
    rows = session.rows[chosen]
    rows = replace(rows, frame=np.arange(len(kept)), time_ns=rows.time_ns - rows.time_ns[0])
    begins = np.searchsorted(kept, [number for number, _ in session.calibrations]).tolist()
    calibrations = tuple(
        (begin, one)
        for begin, stop, (_, one) in zip(begins, [*begins[1:], len(kept)], session.calibrations, strict=True)
        if begin < stop
    )
    # nobody knows it of this part
    of_all = "dropped", "others_seen"
    about = {n: of for n, of in session.about["session"].items() if not n.startswith(of_all)}
    before = about.get("seconds_before", [0.0])[0]
    about["seconds_before"] = [before + 1e-9 * float(session.rows.time_ns[first])]
    numbers = session.numbers[kept]
    about["first_frame"] = [int(numbers[0])]
    told_only = 0 if "frames" in about else session.left_out  # by a version that did not say which
    about["left_out"] = [told_only + int(numbers[-1] + 1 - numbers[0]) - len(kept)]
    runs = np.split(numbers, 1 + np.flatnonzero(np.diff(numbers) > 1))
    about["frames"] = [json.dumps([[int(run[0]), int(run[-1]) + 1] for run in runs])]
    return replace(
        session,
        path=None,
        rows=rows,
        calibrations=calibrations,
        events=tuple(_events(session, kept, calibrations, rows.time_ns)),
        about={**session.about, "session": about},
        images=PartOfImages(session.images, kept),
    )


def _events(
    session: SessionData, kept: NDArray[np.int64], calibrations: Any, time_ns: NDArray[np.int64]
) -> Iterator[Event]:
    """The events of the kept frames, and what lasts into them: calibrations, spells, the first warnings."""
    start_ns, every = int(session.rows.time_ns[kept[0]]), len(session)
    own = {int(number): k for k, number in enumerate(kept)}

    def later(event: Event) -> Event | None:
        """The event at its frame, or at the next one that is kept; None after the last one."""
        k = own.get(event.frame)
        if k is None and event.frame >= every > kept[-1] == every - 1:  # of a frame that is lost
            k = len(kept) + event.frame - every
        if k is not None:
            return event.placed(k, event.time_ns - start_ns)
        k = int(np.searchsorted(kept, event.frame))
        return event.placed(k, int(time_ns[k])) if k < len(kept) else None

    numbers = {id(one): number for number, one in session.calibrations}
    for begin, one in calibrations:
        if numbers[id(one)] not in own:
            yield Event(f"calibrated: {one.how}").placed(begin, int(time_ns[begin]))
    lasting: dict[int, Event | None] = {}
    for spell in spells_of(session.events):
        begun, ended = later(spell.start), None if spell.end is None else later(spell.end)
        next_kept = int(np.searchsorted(kept, spell.start.frame))
        seen = begun is not None and (
            spell.end is None or next_kept == len(kept) or kept[next_kept] <= spell.end.frame
        )
        lasting[id(spell.start)] = begun if seen else None
        if spell.end is not None:
            lasting[id(spell.end)] = ended if seen else None
    for event in session.events:
        if id(event) in lasting:
            placed = lasting[id(event)]
        elif event.frame in own or event.frame >= every:
            placed = later(event)
        else:
            told = event.frame == 0 and event.phase == "moment" and event.level != "INFO"
            placed = later(event) if told else None
        if placed is not None:
            yield placed


class PartOfImages(SessionImages):
    """The images of some frames, which are numbered from 0."""

    def __init__(self, images: SessionImages, kept: NDArray[np.int64]) -> None:
        self._images, self._kept = images, kept

    def depth(self, side: str, frames: range) -> Images[NDArray[np.uint16]]:
        return self._of(lambda every: self._images.depth(side, every), frames)

    def color(self, side: str, frames: range) -> Images[ColorImage]:
        return self._of(lambda every: self._images.color(side, every), frames)

    def others(self, side: str, frames: range) -> Images[NDArray[np.float32]]:
        return self._of(lambda every: self._images.others(side, every), frames, lambda bones: not len(bones))

    def logged(self) -> Iterator[tuple[str, pa.RecordBatch]]:
        """Of a frame that is left out, the newest in the next one."""
        for entity, batch in self._images.logged():
            if layout.FRAME in batch.schema.names:
                at = batch.schema.get_field_index(layout.FRAME)
                frames = np.searchsorted(self._kept, numbers_of(batch.column(at)))
                newest = np.append(frames[1:] != frames[:-1], True) & (frames < len(self._kept))
                batch = batch.set_column(at, batch.schema.field(at), pa.array(frames)).filter(
                    pa.array(newest)
                )
            yield entity, batch

    def _of(
        self, source: Callable[[range], Images[T]], frames: range, ends: Callable[[T], bool] = lambda _: False
    ) -> Images[T]:
        """Those of some frames; what `ends` something in a frame that is left out does so in the next one."""
        kept = self._kept[frames.start : frames.stop]
        if not len(kept):
            return Images()
        images = source(range(int(kept[0]), int(kept[-1]) + 1))

        def made() -> Iterator[tuple[int, T]]:
            due, left_out = frames.start, None
            for number, image in images:
                k = int(np.searchsorted(kept, number))
                if left_out is not None and left_out[0] < k:
                    yield left_out
                    left_out = None
                if kept[k] != number:
                    left_out = (frames.start + k, image) if ends(image) else left_out
                elif frames.start + k >= due:
                    due, left_out = frames.start + k + frames.step, None
                    yield frames.start + k, image
            if left_out is not None:
                yield left_out
            part.damaged = images.damaged

        part = Images(made)
        return part
