"""Reads two recordings of one capture, puts them on one clock, and pairs their frames."""

from __future__ import annotations

import filecmp
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from devices.depth.image_thinning import Depth, thinned, thinned_camera
from devices.frame_pairs import FramePair
from devices.pairing import (
    Pairing,
    clock_by_arrival,
    clock_by_cable,
    clock_by_motion,
    clock_in_question,
    jumps_closed,
    pair_views,
)
from devices.people.recorded_people import Follow, OneRecording, RecordedPeople, SeenPerson
from devices.recorded.files import (
    depth_offset,
    frame_count,
    has_images,
    images_of,
    not_of_libk4a,
    open_images,
    open_source,
    without_images,
)
from devices.sensor import CableSync, DeviceError, ImageRecording, Orientation, Sensor
from devices.skeletons.file_sensor import SkeletonRecording
from devices.skeletons.stated_format import UNSTATED, StatedFormat
from devices.tracker_choice import TrackerChoice, choose_tracker
from fusion.body import BODIES, Body
from fusion.clocks import Clock, median_interval
from fusion.intrinsics import Intrinsics
from fusion.pair_arrays import Pairs, View, joined_views
from fusion.support.large_arrays import give_back, parts
from fusion.support.progress import Progress, quietly
from fusion.support.types import Array

if TYPE_CHECKING:
    from fusion.calibration.surface_fit import SharedSurface

_CLOCKS_AGREE_NS = 1_000_000
"""Tolerance between the measured and the configured sync delay; the sensors are accurate to 0.1 ms."""

_SAMPLES = 200  # skeletons that tell whether a sensor stands upright


@dataclass(frozen=True, eq=False)
class TwoRecordings:
    """The content of two recordings without their images.

    Attributes:
        body: Of both.
        pairing: Their frames, paired.
        intrinsics: Of the depth cameras, if the recordings state them.
        warnings: Warnings for the user about them, one line each.
        images: The files that hold depth images, A's and B's; None for skeletons alone.
        tracker: The body tracker that found the people; empty if the files had skeletons.
        clock: The offset by which B's times were corrected; None if they are as recorded.
        stated: What was stated about the files.
        others: The people who are not followed, of each recording; None if there are none.
        people: If several are seen, those who are seen for some time; the one followed comes first.
        question: Where the motion does not tell the clocks' offset, those that may be right, a line.
        orientations: Of both sensors; intrinsics, skeletons and depth images are of the upright sensors.
    """

    body: Body
    pairing: Pairing
    intrinsics: tuple[Intrinsics | None, Intrinsics | None]
    warnings: tuple[str, ...]
    images: tuple[Path | None, Path | None] = (None, None)
    tracker: str = ""
    clock: Clock | None = None
    stated: StatedFormat = UNSTATED
    orientations: tuple[Orientation, Orientation] = (0, 0)
    others: tuple[RecordedPeople | None, RecordedPeople | None] = (None, None)
    people: tuple[SeenPerson, ...] = ()
    question: str = ""

    @property
    def others_seen(self) -> float:
        """The share of pairs in which a sensor sees somebody who is not followed."""
        frames = self.pairing.pairs.skeletons.frames
        seen = np.zeros(len(frames), dtype=np.bool_)
        for of_view, others in zip(frames.T, self.others, strict=True):
            if others is not None:
                seen |= np.isin(of_view, others.frame)
        return float(seen.mean())

    def cameras(self, depth: Depth) -> tuple[Intrinsics | None, Intrinsics | None]:
        """The intrinsics, for depth images as they are logged."""
        a, b = (None if camera is None else thinned_camera(camera, depth) for camera in self.intrinsics)
        return a, b

    def depth_images(
        self, side: str, depth: Depth, progress: Progress = quietly
    ) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """A sensor's depth images and the numbers of their pairs, in a separate pass over the file.

        One image is in memory at a time, however long the recordings are.
        """
        pairs = self.pairing.pairs
        if depth == "none":
            return
        frames = enumerate(getattr(pair, side) for pair in pairs)
        number = {frame.time_ns: k for k, frame in frames if frame is not None}
        for k, image in self._images_of(side, number, progress):
            yield k, thinned(image, depth)

    def shared_surface(self, moments: Pairs, progress: Progress = quietly) -> SharedSurface | None:
        """What the depth images of some pairs show to both sensors; None without them.

        Images are read in a separate pass over the files, up to the last of these pairs.
        """
        a, b = self.intrinsics
        if a is None or b is None or None in self.images:
            return None
        from devices.depth.surface import shared_surface

        images, others = [], []
        for k, side in enumerate("ab"):
            frames = moments.frames[:, k].tolist()
            times = moments.views[k].time_ns[frames].tolist()
            number = dict(zip(times, frames, strict=True))
            images.append(dict(self._images_of(side, number, progress)))
            others.append({frame: self._others_in(k, frame) for frame in frames})
        offsets = [depth_offset(path) for path in self.images if path is not None]
        return shared_surface(moments, images, (a, b), others, (offsets[0], offsets[1]))

    def _others_in(self, side: int, frame: int) -> list[Array]:
        """(J, 3) of each person in a frame who is not followed."""
        people = self.others[side]
        if people is None or people.body is not self.body:
            return []
        first, end = np.searchsorted(people.frame, (frame, frame + 1)).tolist()
        return [at.astype(np.float64) for at in people.skeletons.positions[first:end]]

    def _images_of(
        self, side: str, number: dict[int, int], progress: Progress
    ) -> Iterator[tuple[int, NDArray[np.uint16]]]:
        """The upright depth images at these times, with their numbers, up to the last."""
        path, orientation = self.images["ab".index(side)], self.orientations["ab".index(side)]
        if path is None or not number:
            return
        from devices.upright import turned_image

        last_ns = max(number)
        with open_images(path) as recording:
            for frame in progress(recording.frames(), f"depth of {recording.name}", len(self.pairing.pairs)):
                k = number.get(frame.time_ns)
                if k is not None and frame.depth is not None:
                    yield k, turned_image(frame.depth, orientation)
                if frame.time_ns >= last_ns:
                    return


@dataclass(frozen=True)
class RecordingChoice:
    """One of the two recordings.

    Attributes:
        path: Recorded skeletons, or a recording with images.
        skeletons: Saved skeletons of an Azure Kinect recording, used instead of the body tracker.
        person: Id of the person; if None, the one seen longest by both sensors.
        stated: Statements about a ``.csv``: unit, axes, names of the joints.
        body: Family of the body tracker of both recordings; found from the joints of both if empty.
        orientation: Of the sensor, for a recording of images; if None, found from the person.
        skeletons_option, person_option: Names by which the user knows these two, for messages.
    """

    path: Path
    skeletons: Path | None = None
    person: str | None = None
    stated: StatedFormat = UNSTATED
    skeletons_option: str = "skeletons"
    person_option: str = "person"
    body: str = ""
    orientation: Orientation | None = None

    @property
    def is_tracked(self) -> bool:
        """Whether its people come from a body tracker."""
        return has_images(self.path) and self.skeletons is None


def read_two(
    choice_a: RecordingChoice,
    choice_b: RecordingChoice,
    tracker: TrackerChoice | None = None,
    progress: Progress = quietly,
    *,
    offset_ns: int | None = None,
    every_frame: bool = True,
    follow: Follow = "longest",
) -> TwoRecordings:
    """Reads both recordings, one after the other: only one body tracker is in the GPU's memory at once.

    If B's clock is off by two thirds of a frame or more and the motion shows by how much, its times are
    corrected.

    Args:
        tracker: The body tracker, if one is needed. None: chosen for this machine.
        offset_ns: Added to the times of B; found from the motion if None.
        every_frame: Whether frames without a partner are kept; see :func:`devices.pairing.pair_views`.
        follow: Which of several people to follow, if no id is given; see
            :func:`devices.people.recorded_person.follow_one_person`.

    Raises:
        DeviceError: A recording cannot be read or tracked, both are the same recording, the bodies differ,
            or the two never overlap.
    """
    refuse_same(choice_a.path, choice_b.path)
    tracked = any(choice.is_tracked for choice in (choice_a, choice_b))
    if tracked:
        tracker = (tracker or choose_tracker()).for_images_of(not_of_libk4a(choice_a.path, choice_b.path))
    a, b = (
        open_source(
            choice.path,
            choice.skeletons,
            tracker,
            choice.skeletons_option,
            progress=progress,
            stated=replace(choice.stated, side=side),
            orientation=choice.orientation,
        )
        for side, choice in (("a", choice_a), ("b", choice_b))
    )
    if isinstance(a, SkeletonRecording) and isinstance(b, SkeletonRecording):
        a.partner, b.partner = b, a
    from devices.people.recorded_person import follow_one_person  # not where files are only read

    read_a, read_b = _read(a, choice_a, progress), _read(b, choice_b, progress)
    stated = None if offset_ns is None else Clock(offset_ns)
    by_arrival = None if stated else clock_by_arrival(read_a.arrivals, read_b.arrivals)
    of_images = has_images(choice_a.path) or has_images(choice_b.path)
    if stated is None and by_arrival is None and not of_images:
        read_a, read_b = _going_on(read_a, read_b)
    read_a, read_b, people = follow_one_person((read_a, read_b), stated, follow)
    body, about_body = _body_of_both((a, b), (read_a, read_b), choice_a.body)
    read_a, read_b = (
        replace(read, person=_as_body(read.person, source.body, body))
        for source, read in ((a, read_a), (b, read_b))
    )
    clock, question = by_arrival, ""
    if stated is None:
        delay_ns = cable_delay_ns(read_a.sync, read_b.sync)
        if by_arrival is None:
            clock = clock_by_motion(body, read_a.seen, read_b.seen)
            question = "" if clock else clock_in_question(body, read_a.seen, read_b.seen)
        elif delay_ns is not None:
            times = read_a.person.time_ns, read_b.person.time_ns
            clock = by_arrival = clock_by_cable(by_arrival, delay_ns, *times)
        give_back()
    try:
        pairing = pair_views(body, read_a.person, read_b.person, clock or stated or Clock(), every_frame)
    except DeviceError as fault:
        raise DeviceError(" ".join(filter(None, (str(fault), question)))) from None
    about_clocks = clock_warnings(read_a.sync, read_b.sync, pairing.pairs)
    if by_arrival is not None:
        about_clocks = [
            "B's times were put on A's clock by the frames' arrival on the PC that recorded them."
        ]
    elif clock is not None:
        about_clocks = [
            f"The clocks differ: {clock.offset_ns * 1e-6:+.0f} ± {clock.sd_ns * 1e-6:.0f} ms"
            f"{_course_in_words(clock)} were added to B's times, so that both views show one motion. "
            "`offset_ms=MS` sets another correction."
        ]
    questions = [question] if question else []
    warnings = *read_a.warnings, *read_b.warnings, *about_body, *about_clocks, *questions
    path_a, path_b = (choice.path if has_images(choice.path) else None for choice in (choice_a, choice_b))
    name = tracker.full_name if tracked and tracker is not None else ""
    return TwoRecordings(
        *(body, pairing, (read_a.intrinsics, read_b.intrinsics), warnings, (path_a, path_b), name, clock),
        *(choice_a.stated, (read_a.orientation, read_b.orientation), (read_a.others, read_b.others)),
        people=people,
        question=question,
    )


def _body_of_both(
    sources: tuple[Sensor, Sensor], reads: tuple[OneRecording, OneRecording], stated: str
) -> tuple[Body, list[str]]:
    """The body that has the joints seen in either recording, and a warning where it is a guess.

    Raises:
        DeviceError: There is none, or not the one stated.
    """
    both = [source.body for source in sources]
    names = {
        body.joints[j]
        for body, read in zip(both, reads, strict=True)
        for j in np.flatnonzero(read.person.states.any(axis=0))
    }
    fixed = [source.body for source in sources if not isinstance(source, SkeletonRecording)]
    wanted = [BODIES[stated]] if stated else list(BODIES.values())
    fitting = [
        body
        for body in wanted
        if all(body is of for of in fixed) and all(body.find(name) is not None for name in names)
    ]
    if stated and not fitting:
        strangers = sorted(name for name in names if wanted[0].find(name) is None)
        lacks = (
            f"has no {', '.join(strangers[:4])}" if strangers else f"is not {fixed[0].name}, of the images"
        )
        raise DeviceError(f"`body={stated}`: it {lacks}.")
    if both[0] is not both[1] and not fitting:
        (a, b), (body_a, body_b) = sources, both
        raise DeviceError(
            f"{a.name} has the {len(body_a)} joints of {body_a.name}, {b.name} the {len(body_b)} of "
            f"{body_b.name}. Both sensors must be of one family."
        )
    if stated or fixed or len(fitting) < 2:
        return fitting[0] if stated or both[0] is not both[1] else both[0], []
    body = both[0] if both[0] is both[1] else fitting[0]
    listed = ", ".join(one.name for one in fitting)
    return body, [
        f"The joints of both recordings fit {listed}: the errors of {body.name}'s tracker are assumed. State "
        "the family of yours with `body`."
    ]


def _as_body(view: View, body: Body, other: Body) -> View:
    """The same joints as those of another body; its further joints are not tracked."""
    if other is body or not len(view.time_ns):
        return view
    of = [body.find(name) for name in other.joints]
    has, joints = [j is not None for j in of], [j for j in of if j is not None]

    def block(rows: slice) -> View:
        count = len(view.time_ns[rows])
        at = np.full((count, len(other), 3), np.nan, np.float32)
        states = np.zeros((count, len(other)), np.uint8)
        at[:, has], states[:, has] = view.positions[rows][:, joints], view.states[rows][:, joints]
        return View(view.time_ns[rows], at, states)

    return joined_views(block(rows) for rows in parts(len(view.time_ns)))


def _going_on(a: OneRecording, b: OneRecording) -> tuple[OneRecording, OneRecording]:
    """The same with times that go on where a clock was set, by who is seen longest, and lines about it."""
    reads = a, b
    if a.people.body is not b.people.body:
        return reads
    from fusion.clocks.parts import parts_joined  # not where files are only read

    view_a, view_b = (
        read.people.view([read.people.choose_person(read.wanted, read.name, read.option)]) for read in reads
    )
    if not (a.people.sets or b.people.sets):
        return _without_jumps(reads, jumps_closed(a.people.body, view_a, view_b))
    joined = parts_joined(a.people.body, view_a, view_b, (a.people.sets, b.people.sets))
    if joined.unsure is not None:
        if a.people.crowded or b.people.crowded:
            return reads  # it may be somebody else
        side, first = joined.unsure.side, joined.unsure.first
        told = (
            f"{reads[side].name}: its clock was set {_seconds_to(reads[side], first):.2f} s after the first "
            "frame, and the movement does not tell how the times go on; they do as if no frame was lost."
        )
        return (_told(a, told), b) if side == 0 else (a, _told(b, told))
    lines: tuple[list[str], list[str]] = [], []
    for cut, by_ns in joined.moved:
        read, by = reads[cut.side], f"{abs(by_ns) * 1e-9:.3f} s"
        if by_ns > 0:
            what = f"at least {by} are missing where the clock was set"
        else:
            what = f"{by} are too many where the clock was set"
        if not cut.certain or abs(by_ns) > 2 * median_interval(read.people.time_ns):
            lines[cut.side].append(f"{read.name}: by the movement, {what}.")
    read_a, read_b = (
        replace(read, people=read.people.at(times), warnings=[*read.warnings, *told])
        for read, times, told in zip(reads, joined.times, lines, strict=True)
    )
    return (read_a, read_b) if joined.moved else reads


def _without_jumps(
    reads: tuple[OneRecording, OneRecording], views: tuple[View, View]
) -> tuple[OneRecording, OneRecording]:
    """The recordings with the times of the person in `views`, and a line about a time that jumped ahead."""
    closed = []
    for read, view in zip(reads, views, strict=True):
        by_ns = int(read.people.time_ns[-1] - view.time_ns[-1])
        if by_ns:
            jumped = f"the clock jumped by {by_ns * 1e-9:.3f} s, as one that is set"
            line = f"{read.name}: by the movement, {jumped}; from there, the times go on."
            read = _told(replace(read, people=read.people.at(view.time_ns)), line)
        closed.append(read)
    return closed[0], closed[1]


def _told(read: OneRecording, line: str) -> OneRecording:
    return replace(read, warnings=[*read.warnings, line])


def _seconds_to(read: OneRecording, frame: int) -> float:
    return 1e-9 * float(read.people.time_ns[frame] - read.people.time_ns[0])


def _course_in_words(clock: Clock) -> str:
    if clock.steps:
        longer = ", ".join(f"{longer_ns * 1e-6:+.0f}" for _, longer_ns in clock.steps)
        return f", changing in steps of {longer} ms, as when times are frame numbers and frames were lost,"
    return f", growing by {clock.rate_ppm:+.1f} millionths of the time," if clock.rate_ppm else ""


def clock_warnings(a: CableSync | None, b: CableSync | None, pairs: Iterable[FramePair]) -> list[str]:
    """Warnings about the two clocks; none for recordings without information about their origin.

    On a sync cable the master's first pulse starts the subordinate's clock at the master's time, so that the
    skew of right pairs is the delay set. Firmware 1.6.107 and later may not restart the clock: the skew shows
    that it has an offset, but only arrivals show by how many whole frames. Without a cable each clock starts
    with its sensor.
    """
    if a is None or b is None:
        return []
    delay_ns = cable_delay_ns(a, b)
    if delay_ns is None:
        return [
            f"The sensors ran without a common clock ({a.mode.lower()}, {b.mode.lower()}): frames "
            f"are paired as if both had been started at the same moment. Record with a sync cable."
        ]
    off_ns = int(np.median([pair.skew_ns for pair in pairs])) - delay_ns
    if abs(off_ns) <= _CLOCKS_AGREE_NS:
        return []
    return [
        f"The sensors captured {delay_ns / 1e6:.2f} ms apart by their cable, but their times lie "
        f"{(off_ns + delay_ns) / 1e6:.1f} ms apart: the subordinate's clock was not set by its master, and "
        f"frames may be paired with their neighbours. Start the subordinate first, the master last."
    ]


def cable_delay_ns(a: CableSync | None, b: CableSync | None) -> int | None:
    """How much later B captures than A by their sync cable; None without one."""
    if a is None or b is None or {a.mode, b.mode} != {"MASTER", "SUBORDINATE"}:
        return None
    return b.delay_ns if b.mode == "SUBORDINATE" else -a.delay_ns


def refuse_same(a: Path, b: Path) -> None:
    """Raises a DeviceError if two recordings are one."""
    try:
        files = a.is_file() and b.is_file()
        same, compared = files and a.samefile(b), files and a.stat().st_size > 0
        if not same and compared and not (has_images(a) or has_images(b)):
            same = filecmp.cmp(a, b, shallow=False)
    except OSError:
        return  # the readers say what is wrong with the files
    from devices.skeletons.csv_files.text import has_several_sensors  # of one file that is given twice

    if same and not (a.suffix.lower() == ".csv" and has_several_sensors(a)):
        raise DeviceError(f"{a} and {b} are the same recording. Fusion needs one recording of each sensor.")


def _read(source: Sensor, choice: RecordingChoice, progress: Progress) -> OneRecording:
    with source:
        sync, arrivals = None, []
        if isinstance(source, SkeletonRecording):
            people = source.people
        else:
            work = "tracking" if choice.is_tracked else "reading"
            read = progress(without_images(source), f"{work} {source.name}", frame_count(source))
            people = RecordedPeople.of(source.body, read)
            images = images_of(source)
            if isinstance(images, ImageRecording):
                sync, arrivals = images.sync, list(images.arrivals)
        warnings = list(source.warnings)
    people.choose_person(choice.person, source.name, choice.person_option)
    camera, orientation = source.intrinsics, choice.orientation or 0
    if choice.orientation is None and has_images(choice.path):
        from devices.upright import orientation_of, turned_camera, turned_view

        some = slice(None, None, max(1, len(people.frame) // _SAMPLES))
        seconds = np.asarray(people.skeletons.time_ns[some] * 1e-9, dtype=np.float64)
        orientation, other = orientation_of(people.body, seconds, people.skeletons.positions[some])
        if orientation:
            people = replace(people, skeletons=turned_view(people.skeletons, orientation))
            camera = None if camera is None else turned_camera(camera, orientation)
            tracked = f"`orientation={orientation}` also tracks it so; " if choice.is_tracked else ""
            warnings.append(
                f"{source.name}: the sensor is turned clockwise by {orientation}°. Its images and skeletons "
                f"are turned upright; {tracked}`orientation=0` leaves them."
            )
        elif other:
            warnings.append(
                f"{source.name}: either the person lies, or the sensor is turned clockwise by {other}°; "
                f"`orientation={other}` turns it upright."
            )
    give_back()
    times = np.array(arrivals, dtype=np.int64).reshape(-1, 2)
    return OneRecording(
        *(source.name, people, sync, warnings, times, people.skeletons),
        *(choice.person, choice.person_option, camera, orientation),
    )
