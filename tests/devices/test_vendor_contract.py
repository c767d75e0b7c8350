"""One contract of faults for the live sensors of all vendors, in virtual time."""

import gc
import os
import weakref
from dataclasses import dataclass
from itertools import pairwise
from unittest.mock import patch

import pytest

from devices.capture import usb
from devices.capture.causes import Cause
from devices.sensor import AbsentError, DeviceError
from tests.helpers.usb_tree import plug_in
from tests.helpers.vendors import DRIVERS, A, B, OrbbecDriver

ALL = ("azure", "orbbec", "realsense", "freenect", "freenect2")


def of(*vendors):
    """Parametrizes a test with the drivers of these vendors."""
    return pytest.mark.parametrize("driver", vendors, indirect=True)


EVERY, COLORED = of(*ALL), of("azure", "orbbec", "realsense", "freenect")
INFRARED = of("azure", "orbbec", "realsense")
OPENED = of("azure", "orbbec", "realsense", "freenect")  # v2: test_contract.py there, by its library


@pytest.fixture
def driver(request, monkeypatch):
    """The driver of the vendor that the test's parameter names."""
    kind, fixture = DRIVERS[request.param]
    given = [] if fixture is None else [request.getfixturevalue(fixture)]
    return kind(*given, *[monkeypatch] * (kind is not OrbbecDriver))


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


def watch(driver, sensor, seconds, reader_s=lambda _: 0.0, frames=None):
    """Reads frames for so long, with a reader that takes ``reader_s`` of the time for each."""
    begun_ns, seen = driver.time.now_ns(), Watched([], [], [], [])
    for frame in sensor.frames() if frames is None else frames:
        now_ns = driver.time.now_ns()
        at_s = (now_ns - begun_ns) * 1e-9
        seen.numbers.append(driver.number(frame))
        seen.ages.append((now_ns - frame.host_ns) * 1e-9)
        seen.colored.append(frame.color is not None or getattr(sensor, "rgb", None) is not None)
        seen.told += [(at_s, text) for text in sensor.take_news()]
        if at_s >= seconds:
            break
        driver.time.wait_until(now_ns + round(1e9 * reader_s(at_s)))
    return seen


def whole(seen):
    """Whether every exposure from the first one given to the last was given once, in order."""
    return seen.numbers == list(range(seen.numbers[0], seen.numbers[-1] + 1))


# ------------------------------------------------------------------ images beside depth


@EVERY
def test_every_depth_image_is_given_at_once_with_its_image(driver):
    with driver.sensor(**(driver.color or {})) as sensor:
        seen = watch(driver, sensor, 5.0)
    assert whole(seen)
    assert len(seen.numbers) > 145
    assert (sensor.missed, sensor.lost, seen.told) == (0, 0, [])
    assert max(seen.ages) < 0.06, "colour comes 25 ms later"
    if driver.color is not None:
        assert all(seen.colored)


@COLORED
def test_in_a_dark_room_no_depth_is_lost_and_the_colour_camera_is_named(driver):
    """Auto exposure halves the colour camera's rate."""
    driver.image_lost(lambda number: number > 60 and number % 2 == 0)
    with driver.sensor(**driver.color) as sensor:
        seen = watch(driver, sensor, 8.0)
    assert whole(seen)
    assert (sensor.missed, sensor.lost) == (0, 0)
    assert seen.first_told(Cause.FEW_IMAGES) == pytest.approx(2.0 + 2.0, abs=1.0), "within 3 s"
    ((_, text),) = seen.told
    assert "gives 15 colour images per second, not 30" in text
    assert max(seen.ages) < 0.1


@COLORED
def test_a_dead_colour_camera_is_named_and_depth_goes_on(driver):
    driver.image_lost(lambda number: 60 < number <= 300)
    with driver.sensor(**driver.color) as sensor:
        seen = watch(driver, sensor, 14.0)
    assert whole(seen)
    assert (sensor.missed, sensor.lost) == (0, 0)
    assert seen.first_told(Cause.NO_IMAGES) == pytest.approx(2.0 + 2.0, abs=1.0), "within 3 s"
    late = [age for number, age in zip(seen.numbers, seen.ages, strict=True) if 60 + 75 < number <= 300]
    assert max(seen.ages) < 0.25, "pairing waits no longer"
    assert max(late) < 0.06, "nothing is waited for that does not come"
    assert "gives all colour images again" in seen.told[-1][1]
    assert len(seen.told) == 2
    assert all(seen.colored[-60:])


@COLORED
@pytest.mark.parametrize("cause", [Cause.NO_IMAGES, Cause.LATE_IMAGES])
def test_colour_that_never_comes_or_too_late_to_be_joined_is_named(driver, cause):
    driver.image_lost(lambda _: cause is Cause.NO_IMAGES)
    driver.late_image(400_000_000)
    with driver.sensor(**driver.color) as sensor:
        seen = watch(driver, sensor, 6.0)
    assert whole(seen)
    assert seen.first_told(cause) < 3.0
    assert (sensor.missed, sensor.lost, len(seen.told)) == (0, 0, 1)


@INFRARED
@pytest.mark.parametrize(
    ("lost", "cause"), [(lambda k: k > 60, Cause.NO_IMAGES), (lambda k: k % 2, Cause.FEW_IMAGES)]
)
def test_missing_infrared_is_named_and_depth_goes_on(driver, lost, cause):
    driver.infrared_lost(lost)
    with driver.sensor(**({"infrared": True} if "infrared" in vars(driver.settings()) else {})) as sensor:
        seen = watch(driver, sensor, 8.0)
    assert whole(seen)
    assert (sensor.missed, sensor.lost) == (0, 0)
    assert seen.first_told(cause) < 5.0
    assert "infrared images" in seen.told[0][1]
    assert "No one is found without them" in seen.told[0][1]


# ------------------------------------------------------------------ readers, recordings, losses


@EVERY
@pytest.mark.parametrize("recording", [False, True])
def test_a_slow_reader_gets_the_newest_frame_and_the_rest_are_counted(driver, recording):
    recorded = []
    with driver.sensor() as sensor:
        sensor.on_capture = recorded.append if recording else None
        seen = watch(driver, sensor, 8.0, lambda _: 0.08)
    assert max(seen.ages[1:]) < 0.07, "a frame's time, and its way"
    assert sensor.missed == seen.numbers[-1] - seen.numbers[0] + 1 - len(seen.numbers)
    assert sensor.lost == 0
    if recording:
        numbers = [driver.number(frame) for frame in recorded]
        assert numbers == list(range(numbers[0], numbers[-1] + 1)), "made once, in order"


@EVERY
def test_a_reader_that_stops_for_half_a_second_costs_no_more_than_that(driver):
    with driver.sensor() as sensor:
        seen = watch(driver, sensor, 6.0, lambda at_s: 0.5 if 2.0 <= at_s < 2.04 else 0.0)
    (gap,) = [later - first for first, later in pairwise(seen.numbers) if later - first > 1]
    assert 13 <= gap <= 17
    assert (sensor.missed, sensor.lost) == (gap - 1, 0)


@EVERY
@pytest.mark.parametrize("cost_s", [0.02, 0.04, 0.1])
def test_a_recording_slower_than_the_camera_holds_up_neither_frames_nor_the_end(driver, cost_s):
    """Images come first: then the SDK's queue is full, and the newest frame is as old as it is long."""
    recorded = []
    with driver.sensor() as sensor:
        frame_of = sensor.frame_of

        def costly(moment):
            driver.time.wait_until(driver.time.now_ns() + round(1e9 * cost_s))
            return frame_of(moment)

        sensor.frame_of, sensor.on_capture = costly, lambda frame: recorded.append(driver.number(frame))
        frames = sensor.frames()
        seen = watch(driver, sensor, 10.0, frames=frames)
        asked_ns = driver.time.now_ns()
        sensor.interrupt()
        assert len(list(frames)) <= 2
        assert driver.time.now_ns() - asked_ns < 1_000_000_000
    assert recorded == sorted(set(recorded)), "each is made once"
    settled = len(seen.ages) // 2
    assert len(seen.numbers) > 10.0 / (0.55 + cost_s), "the queue is emptied for half a second at most"
    assert len(recorded) > 0.9 * 10.0 / max(cost_s, 1.0 / 30.0), "all that there is time for"
    assert max(seen.ages[settled:]) < (0.08 + 2 * cost_s if cost_s < 1.0 / 30.0 else 0.7)
    assert sensor.missed + sensor.lost == seen.numbers[-1] - seen.numbers[0] + 1 - len(seen.numbers)
    assert sensor.lost == 0 or cost_s > 1.0 / 30.0  # librealsense does not tell how long a frame waited


@EVERY
def test_what_usb_loses_counts_as_lost_only(driver):
    driver.depth_lost(lambda number: number % 10 == 0 or number in (61, 62))
    with driver.sensor(**(driver.color or {})) as sensor:
        seen = watch(driver, sensor, 8.0)
    span = seen.numbers[-1] - seen.numbers[0] + 1
    assert sensor.lost == span - len(seen.numbers) > 20
    assert sensor.missed == 0


@EVERY
def test_many_openings_leave_nothing(driver):
    left = []

    def cycle():
        sensor = driver.sensor(**(driver.color or {}))
        with sensor:
            frames = sensor.frames()
            next(frames)
            left.append(weakref.ref(sensor._stream.joiner))
            frames.close()
        assert sensor._stream is None

    for _ in range(20):
        cycle()
    gc.collect()
    assert [ref() for ref in left if ref() is not None] == []
    assert list(driver.open_serials) == []


# ------------------------------------------------------------------ silence


@EVERY
@pytest.mark.parametrize("fault", ["silent", "blind"])
def test_a_stream_without_depth_stalls(driver, fault):
    with driver.sensor() as sensor:
        frames = sensor.frames()
        next(frames)
        driver.set(**{fault: True})
        begun_ns = driver.time.now_ns()
        with pytest.raises(DeviceError) as told:
            list(frames)
        assert sensor.waits_for == ""
    assert str(told.value) == Cause.NO_DEPTH.says(label=_label(told), seconds=5)
    assert driver.time.now_ns() - begun_ns < 6_000_000_000


@of("azure", "orbbec", "realsense")
def test_colour_without_depth_is_called_so(driver):
    with driver.sensor(**driver.color) as sensor:
        frames = sensor.frames()
        next(frames)
        driver.set(blind=True)
        with pytest.raises(DeviceError) as told:
            list(frames)
    assert str(told.value) == Cause.ONLY_COLOR.says(label=_label(told), seconds=5)


@INFRARED
def test_a_subordinate_says_that_it_waits_for_pulses_until_it_had_one(driver):
    def said_until(message):
        """What it waits for, each time that it waits, until it stalls."""
        said, wait_until = [], driver.time.wait_until
        with (
            patch.object(
                driver.time, "wait_until", lambda ns: said.append(sensor.waits_for) or wait_until(ns)
            ),
            pytest.raises(DeviceError, match=message),
        ):
            list(frames)
        return said

    with driver.sensor(sync="subordinate", start_s=30.0) as sensor:
        frames = sensor.frames()
        driver.set(silent=True)
        said = said_until("no depth for 30 s on the sync cable")
        assert set(said[-10:]) == {"the pulses of its master on the sync cable"}
    if driver.kind.__name__ == "KinectSensor":
        driver.bus.master_begun_ns = driver.time.now_ns()
    elif driver.kind.__name__ == "OrbbecSensor":
        driver.bus.devices[0].sync["mode"] = type(driver.source.sync["mode"]).PRIMARY
        driver.bus.running.append(B)
    driver.set()
    with driver.sensor(sync="subordinate") as sensor:
        frames = sensor.frames()
        next(frames)
        driver.set(silent=True)
        said = said_until("no depth for 5 s on the sync cable")
        assert set(said) == {""}, "its master runs, as far as it knows"


# ------------------------------------------------------------------ opening, unplugging, closing


@OPENED
def test_a_sensor_that_is_not_there_is_named_with_those_that_are(driver):
    driver.unplug()
    for others in (f" Connected: {B}.", ""):
        with pytest.raises(DeviceError) as told:
            driver.sensor().__enter__()
        assert f"with serial {A}" in str(told.value)
        assert others in str(told.value)
        assert (B in str(told.value)) == bool(others)
        assert list(driver.open_serials) == []
        (driver.bus.devices if hasattr(driver, "bus") else driver.there).clear()


@OPENED
def test_a_busy_sensor_is_called_busy_and_the_other_one_opens(driver, monkeypatch):
    driver.busy(A)
    _on_bus(monkeypatch, [])
    with pytest.raises(DeviceError) as told:
        driver.sensor().__enter__()
    assert "it is busy" in str(told.value)
    assert driver.programs in str(told.value)
    assert list(driver.open_serials) == []
    with driver.sensor(B):
        pass


@OPENED
@pytest.mark.parametrize("other", [("045e", "02ae"), ("045e", "097c"), ("8086", "0b07"), ("2bc5", "066b")])
def test_only_its_own_device_file_is_blamed(driver, monkeypatch, tmp_path, other):
    driver.busy(A)
    own = plug_in(tmp_path, "", product=driver.usb[1], vendor=driver.usb[0], number=7)
    others = plug_in(tmp_path, "", product=other[1], vendor=other[0], number=8)
    found = usb.usb_kinects
    for forbidden in (own, others):
        monkeypatch.setattr(os, "access", lambda path, _, forbidden=forbidden: path != forbidden)
        _on_bus(monkeypatch, found(tmp_path))
        with pytest.raises(DeviceError) as told:
            driver.sensor().__enter__()
        related = (
            forbidden == own
            or {driver.usb, other} == {("045e", "097c"), ("2bc5", "066b")}
            or driver.usb == other
        )
        if driver.kind.__name__ == "OrbbecSensor" and forbidden == others and other == ("045e", "097c"):
            related = False  # Microsoft's wrapper opens Orbbec's sensors, not the other way round
        assert (f"no permission for {forbidden}" in str(told.value)) == related


@EVERY
def test_unplugged_while_frames_come(driver):
    with driver.sensor() as sensor:
        frames = sensor.frames()
        next(frames)
        driver.unplug()
        begun_ns = driver.time.now_ns()
        with pytest.raises(AbsentError) as told:
            list(frames)
        assert driver.time.now_ns() - begun_ns <= 1_000_000_000
    assert str(told.value) == Cause.UNPLUGGED.says(label=_label(told))
    del told, frames  # the traceback keeps what it saw
    assert sensor.warnings == [] or driver.kind.__name__ == "FreenectSensor"
    assert list(driver.open_serials) == []


@EVERY
def test_unplugged_at_close_it_closes_and_opens_again(driver):
    sensor = driver.sensor().__enter__()
    next(sensor.frames())
    driver.unplug()
    sensor.__exit__()
    assert list(driver.open_serials) == []
    with pytest.raises(AbsentError):
        sensor.__enter__()
    driver.plug()
    with sensor:
        next(sensor.frames())
    assert list(driver.open_serials) == []


@EVERY
def test_interrupting_ends_a_silent_wait(driver):
    driver.set(silent=True)
    with driver.sensor(stall_s=1e9) as sensor:
        wait_until = driver.time.wait_until

        def wait(ns):
            sensor.interrupt()
            wait_until(ns)

        with patch.object(driver.time, "wait_until", wait):
            assert list(sensor.frames()) == []


def _label(told):
    """The sensor's name in its own messages."""
    words = str(told.value).split(A)[0]
    return f"{words}{A}"


def _on_bus(monkeypatch, devices):
    """What Linux lists."""
    for module in ("azure.pyk4a_access", "orbbec.sdk_access", "realsense.sdk_access", "freenect.libfreenect"):
        monkeypatch.setattr(f"devices.{module}.usb_kinects", lambda: devices)
