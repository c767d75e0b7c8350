"""What live sensors of every vendor share, on one scripted camera in virtual time: faults, times, words."""

from dataclasses import dataclass
from itertools import pairwise
from unittest.mock import patch

import pytest

from devices.capture.causes import Cause
from devices.capture.settings import CaptureSettings
from devices.sensor import AbsentError, DeviceError
from tests.helpers.scripted_camera import Schedule, ScriptedCamera

LABEL = "Camera 000123"


@pytest.fixture
def schedule():
    return Schedule()


def camera(schedule, **settings):
    """The camera, not opened."""
    return ScriptedCamera(schedule, CaptureSettings(**settings))


@dataclass
class Watched:
    """What a reader got: numbers of exposures, ages in s, and what it was told, with the time in s."""

    numbers: list
    ages: list
    colored: list
    told: list

    def first_told(self, cause):
        """When a cause was told."""
        head = cause.value.split("{", 2)[1].split("}", 1)[1].split("{", 1)[0]
        return next((at for at, text in self.told if head in text), None)


def watch(schedule, sensor, seconds, reader_s=lambda _: 0.0, frames=None):
    """Reads frames for so long, with a reader that takes ``reader_s`` of the time for each."""
    begun_ns, seen = schedule.time.now_ns(), Watched([], [], [], [])
    for frame in sensor.frames() if frames is None else frames:
        now_ns = schedule.time.now_ns()
        at_s = (now_ns - begun_ns) * 1e-9
        seen.numbers.append(int(frame.depth[0, 0]))
        seen.ages.append((now_ns - frame.host_ns) * 1e-9)
        seen.colored.append(frame.color is not None)
        seen.told += [(at_s, text) for text in sensor.take_news()]
        if at_s >= seconds:
            break
        schedule.time.wait_until(now_ns + round(1e9 * reader_s(at_s)))
    return seen


def whole(seen):
    """Whether every exposure from the first one given to the last was given once, in order."""
    return seen.numbers == list(range(seen.numbers[0], seen.numbers[-1] + 1))


# ------------------------------------------------------------------ images beside depth


def test_every_depth_image_is_given_at_once_with_its_image(schedule):
    with camera(schedule, color="720P") as sensor:
        seen = watch(schedule, sensor, 5.0)
    assert whole(seen)
    assert len(seen.numbers) > 145
    assert (sensor.missed, sensor.lost, seen.told) == (0, 0, [])
    assert max(seen.ages) < 0.06, "colour comes 25 ms later"
    assert all(seen.colored)


def test_in_a_dark_room_no_depth_is_lost_and_the_colour_camera_is_named(schedule):
    """Auto exposure halves the colour camera's rate."""
    schedule.color_lost = lambda number: number > 60 and number % 2 == 0
    with camera(schedule, color="720P") as sensor:
        seen = watch(schedule, sensor, 8.0)
    assert whole(seen)
    assert (sensor.missed, sensor.lost) == (0, 0)
    assert seen.first_told(Cause.FEW_IMAGES) == pytest.approx(2.0 + 2.0, abs=1.0), "within 3 s"
    ((_, text),) = seen.told
    assert "gives 15 colour images per second, not 30" in text
    assert max(seen.ages) < 0.1


def test_a_dead_colour_camera_is_named_and_depth_goes_on(schedule):
    schedule.color_lost = lambda number: 60 < number <= 300
    with camera(schedule, color="720P") as sensor:
        seen = watch(schedule, sensor, 14.0)
    assert whole(seen)
    assert (sensor.missed, sensor.lost) == (0, 0)
    assert seen.first_told(Cause.NO_IMAGES) == pytest.approx(2.0 + 2.0, abs=1.0), "within 3 s"
    late = [age for number, age in zip(seen.numbers, seen.ages, strict=True) if 60 + 75 < number <= 300]
    assert max(seen.ages) < 0.25, "pairing waits no longer"
    assert max(late) < 0.06, "nothing is waited for that does not come"
    assert "gives all colour images again" in seen.told[-1][1]
    assert len(seen.told) == 2
    assert all(seen.colored[-60:])


@pytest.mark.parametrize("cause", [Cause.NO_IMAGES, Cause.LATE_IMAGES])
def test_colour_that_never_comes_or_too_late_to_be_joined_is_named(schedule, cause):
    schedule.color_lost = lambda _: cause is Cause.NO_IMAGES
    schedule.color_latency_ns = 400_000_000
    with camera(schedule, color="720P") as sensor:
        seen = watch(schedule, sensor, 6.0)
    assert whole(seen)
    assert seen.first_told(cause) < 3.0
    assert (sensor.missed, sensor.lost, len(seen.told)) == (0, 0, 1)


# ------------------------------------------------------------------ readers, recordings, losses


def test_a_reader_that_stops_for_half_a_second_costs_no_more_than_that(schedule):
    with camera(schedule) as sensor:
        seen = watch(schedule, sensor, 6.0, lambda at_s: 0.5 if 2.0 <= at_s < 2.04 else 0.0)
    (gap,) = [later - first for first, later in pairwise(seen.numbers) if later - first > 1]
    assert 13 <= gap <= 17
    assert (sensor.missed, sensor.lost) == (gap - 1, 0)


@pytest.mark.parametrize("cost_s", [0.02, 0.04, 0.1])
def test_a_recording_slower_than_the_camera_holds_up_neither_frames_nor_the_end(schedule, cost_s):
    """Images come first: then the SDK's queue is full, and the newest frame is as old as it is long."""
    recorded = []
    with camera(schedule) as sensor:
        frame_of = sensor.frame_of

        def costly(moment):
            schedule.time.wait_until(schedule.time.now_ns() + round(1e9 * cost_s))
            return frame_of(moment)

        sensor.frame_of, sensor.on_capture = costly, lambda frame: recorded.append(int(frame.depth[0, 0]))
        frames = sensor.frames()
        seen = watch(schedule, sensor, 10.0, frames=frames)
        asked_ns = schedule.time.now_ns()
        sensor.interrupt()
        assert len(list(frames)) <= 2
        assert schedule.time.now_ns() - asked_ns < 1_000_000_000
    assert recorded == sorted(set(recorded)), "each is made once"
    settled = len(seen.ages) // 2
    assert len(seen.numbers) > 10.0 / (0.55 + cost_s), "the queue is emptied for half a second at most"
    assert len(recorded) > 0.9 * 10.0 / max(cost_s, 1.0 / 30.0), "all that there is time for"
    assert max(seen.ages[settled:]) < (0.08 + 2 * cost_s if cost_s < 1.0 / 30.0 else 0.7)
    assert sensor.missed + sensor.lost == seen.numbers[-1] - seen.numbers[0] + 1 - len(seen.numbers)
    assert sensor.lost == 0


def test_what_usb_loses_counts_as_lost_only(schedule):
    schedule.depth_lost = lambda number: number % 10 == 0 or number in (61, 62)
    with camera(schedule, color="720P") as sensor:
        seen = watch(schedule, sensor, 8.0)
    span = seen.numbers[-1] - seen.numbers[0] + 1
    assert sensor.lost == span - len(seen.numbers) > 20
    assert sensor.missed == 0


# ------------------------------------------------------------------ silence


@pytest.mark.parametrize(
    ("fault", "color", "cause"),
    [
        ("silent", None, Cause.NO_DEPTH),
        ("blind", None, Cause.NO_DEPTH),
        ("blind", "720P", Cause.ONLY_COLOR),
    ],
)
def test_a_stream_without_depth_stalls(schedule, fault, color, cause):
    with camera(schedule, color=color) as sensor:
        frames = sensor.frames()
        next(frames)
        setattr(schedule, fault, True)
        begun_ns = schedule.time.now_ns()
        with pytest.raises(DeviceError) as told:
            list(frames)
        assert sensor.waits_for == ""
    assert str(told.value) == cause.says(label=LABEL, seconds=5)
    assert schedule.time.now_ns() - begun_ns < 6_000_000_000


def test_a_subordinate_says_that_it_waits_for_pulses_until_it_had_one(schedule):
    def said_until(message):
        """What it waits for, each time that it waits, until it stalls."""
        said, wait_until = [], schedule.time.wait_until
        with (
            patch.object(
                schedule.time, "wait_until", lambda ns: said.append(sensor.waits_for) or wait_until(ns)
            ),
            pytest.raises(DeviceError, match=message),
        ):
            list(frames)
        return said

    with camera(schedule, sync="subordinate", start_s=30.0) as sensor:
        frames = sensor.frames()
        schedule.silent = True
        said = said_until("no depth for 30 s on the sync cable")
        assert set(said[-10:]) == {"the pulses of its master on the sync cable"}
    schedule.silent = False
    with camera(schedule, sync="subordinate") as sensor:
        frames = sensor.frames()
        next(frames)
        schedule.silent = True
        said = said_until("no depth for 5 s on the sync cable")
        assert set(said) == {""}, "its master runs, as far as it knows"


# ------------------------------------------------------------------ unplugging, interrupting


def test_unplugged_while_frames_come(schedule):
    with camera(schedule) as sensor:
        frames = sensor.frames()
        next(frames)
        schedule.plugged = False
        begun_ns = schedule.time.now_ns()
        with pytest.raises(AbsentError) as told:
            list(frames)
        assert schedule.time.now_ns() - begun_ns <= 1_000_000_000
    assert str(told.value) == Cause.UNPLUGGED.says(label=LABEL)


def test_interrupting_ends_a_silent_wait(schedule):
    schedule.silent = True
    with camera(schedule, stall_s=1e9) as sensor:
        wait_until = schedule.time.wait_until

        def wait(ns):
            sensor.interrupt()
            wait_until(ns)

        with patch.object(schedule.time, "wait_until", wait):
            assert list(sensor.frames()) == []
