"""A remote sensor over real Zenoh sessions: frames, clocks, absence, restarts, hostile input."""

import threading
import time
from contextlib import ExitStack, contextmanager, suppress

import numpy as np
import pytest

from devices.capture.sensor_state import SensorState, TimeLimits
from devices.capture.sensor_thread import SensorThread
from devices.network import messages
from devices.network.messages import FrameMessage, encode_frame
from devices.network.publishing import FramePublisher, publish_until
from devices.network.remote_sensor import CLOCK, RemoteSensor
from devices.network.zenoh_session import ZenohAddresses, zenoh_session
from devices.sensor import AbsentError, DeviceError, SensorFrame
from fusion.body import AZURE_KINECT, KINECT_V2
from fusion.intrinsics import Intrinsics
from fusion.skeleton import Skeleton
from tests.helpers.network import free_address
from tests.helpers.scripted_sensor import ScriptedSensor, frame_at
from tests.helpers.waiting import eventually

pytest.importorskip("zenoh", reason="eclipse-zenoh is not installed: pip install -e '.[zenoh]'")

KEY = "lab/a"
CAMERA = Intrinsics(64, 48, 50.0, 50.0, 31.5, 23.5)


@pytest.fixture
def address():
    return free_address()


@contextmanager
def publisher(address, sensor=None, **more):
    sensor = sensor or ScriptedSensor("000123")
    with FramePublisher(KEY, ZenohAddresses(connect=(address,)), sensor, **more) as open_publisher:
        yield open_publisher


def remote(address, appear_s=20.0):
    return RemoteSensor(KEY, ZenohAddresses(listen=(address,)), appear_s=appear_s)


class Ticking:
    """A clock that a test moves on, added to the real one."""

    now = 0.0

    def __call__(self):
        return time.perf_counter() + self.now


def frames_through(published, thread, wanted):
    """Publishes frames until so many have arrived."""
    came = []

    def more():
        published.publish(frame_at(1_000_000 * published.published, people=True))
        came.extend(arrival.frame for arrival in thread.take())
        return len(came) >= wanted

    assert eventually(more)
    return came


def test_published_frames_arrive_in_order_with_their_capture_times(address):
    with publisher(address) as published, SensorThread(remote(address), keep=64) as thread:
        clock = published._clock
        sent_from = clock()
        came = frames_through(published, thread, 20)
        assert thread.sensor.body is AZURE_KINECT
        times = [frame.time_ns for frame in came]
        assert times == sorted(set(times))
        assert set(came[0].people) == {"1"}
        link = thread.sensor.link
        assert link.lost == 0
        # both programs run on one clock here: what the relation of the clocks claims can be checked
        for frame in came:
            assert sent_from - link.clock_bound_ns <= frame.host_ns <= clock()


def test_depth_images_arrive_if_asked_for(address):
    image = np.arange(64 * 48, dtype=np.uint16).reshape(48, 64)
    sensor = ScriptedSensor()
    sensor.intrinsics = CAMERA
    for depth in (True, False):
        with publisher(address, sensor, depth=depth) as published, remote(address) as far:
            assert far.intrinsics == CAMERA
            frames = far.frames()

            def send(to=published):
                to.publish(SensorFrame(to.published, depth=image))
                return bool(far._inbox)

            assert eventually(send)
            got = next(frames)
            frames.close()
            assert (got.depth is not None) == depth
            if got.depth is not None:
                assert np.array_equal(got.depth, image)


def test_an_absent_sensor_gives_one_line(address):
    with pytest.raises(AbsentError, match=r"Nobody publishes 'lab/a' at tcp/.*Start duplex sensor --publ"):
        remote(address, appear_s=0.0).__enter__()


def test_waiting_for_a_sensor_can_be_interrupted(address):
    far = remote(address, appear_s=3600.0)
    thread = SensorThread(far, limits=TimeLimits(open_s=3600.0))

    def open_it():
        with suppress(DeviceError):
            thread.open()

    opening = threading.Thread(target=open_it)
    opening.start()
    assert eventually(lambda: far.waits_for == "duplex sensor --publish lab/a")
    thread.end()
    opening.join(20.0)
    assert not opening.is_alive()


def test_a_program_that_is_started_anew_is_taken_back(address):
    with ExitStack() as stack:
        stack.enter_context(zenoh_session(ZenohAddresses(listen=(address,))))
        far = remote(address)
        with publisher(address) as published:
            thread = stack.enter_context(SensorThread(far, keep=64, limits=TimeLimits(retry_s=0.05)))
            frames_through(published, thread, 5)
        assert eventually(lambda: thread.state is SensorState.LOST)
        with publisher(address) as published:
            assert eventually(lambda: thread.state is SensorState.RUNNING)
            frames_through(published, thread, 5)
        assert thread.returns == 1
        assert far.link.restarts == 1
        said = [event.text for event in thread.events()]
        assert any("zenoh:lab/a is silent for 1.5 s" in line or "started anew" in line for line in said)
        assert "zenoh:lab/a is back." in said


def test_two_programs_under_one_key_are_reported_and_the_first_goes_on(address):
    with ExitStack() as stack:
        published = stack.enter_context(publisher(address))
        thread = stack.enter_context(SensorThread(remote(address), keep=64))
        frames_through(published, thread, 5)
        elsewhere = ZenohAddresses(connect=(address, address))  # a session of its own
        second = stack.enter_context(FramePublisher(KEY, elsewhere, ScriptedSensor()))
        said = []

        def reported():
            second.publish(frame_at(0, people=True))
            frames_through(published, thread, 1)
            said.extend(thread.sensor.take_news())
            return bool(said)

        assert eventually(reported)
        assert said[0].startswith("zenoh:lab/a: two programs publish under 'lab/a'")
        frames_through(published, thread, 20)
        assert thread.state is SensorState.RUNNING
        assert (thread.returns, thread.sensor.link.restarts, thread.sensor.link.malformed) == (0, 0, 0)


def test_another_body_after_a_restart_gives_one_line(address):
    far = remote(address)
    with publisher(address), far:
        pass
    sensor = ScriptedSensor()
    sensor.body = KINECT_V2
    with (
        publisher(address, sensor),
        pytest.raises(DeviceError, match="reports kinect_v2 now and reported azure"),
    ):
        far.__enter__()


@pytest.mark.parametrize("change", ["body", "version"])
def test_what_is_not_understood_is_named_once_and_is_no_silence(address, change, monkeypatch):
    """Another body than described, as after its driver was started anew; another version of the program."""
    second = [SensorFrame(k, {"1": Skeleton.of(KINECT_V2, np.ones((25, 3)))}) for k in range(60)]
    seconds, said, came = Ticking(), [], []
    thread = SensorThread(remote(address), keep=64, clock=seconds)
    with publisher(address) as published, thread:
        frames_through(published, thread, 3)
        if change == "version":
            monkeypatch.setattr(messages, "PROTOCOL_VERSION", 2)
        encoded = [encode_frame(FrameMessage(published.session, 10 + k, f, 0)) for k, f in enumerate(second)]
        monkeypatch.undo()

        def refused():
            published._publisher.put(encoded[len(encoded) // 2])
            came.extend(arrival.frame for arrival in thread.take())
            said.extend(event.text for event in thread.events())
            seconds.now += 0.2
            return len(said) > 0 and thread.sensor.link.malformed > 50

        assert eventually(refused)
        assert all(frame.people["1"].body is AZURE_KINECT for frame in came)  # sent before
        named = "'kinect_v2', not of 'azure_kinect'" if change == "body" else "messages of version 2, not 1"
        assert len(said) == 1
        assert said[0].startswith("zenoh:lab/a stalls")
        assert named in said[0]
        assert thread.returns == 0
        frames_through(published, thread, 3)
        assert thread.sensor.waits_for == ""


def test_a_sensor_of_another_version_is_named_at_once(address, monkeypatch):
    monkeypatch.setattr(messages, "PROTOCOL_VERSION", 2)
    with publisher(address):
        monkeypatch.undo()
        with pytest.raises(
            AbsentError, match=r"^zenoh:lab/a sends messages of version 2, not 1 \(run the same"
        ):
            remote(address).__enter__()


def test_publishing_ends_with_its_sensor_and_keeps_the_order(address):
    sensor = ScriptedSensor()
    told = []
    with remote_after(publisher(address, sensor), address) as (published, far):
        with SensorThread(sensor, keep=8) as thread:
            sensor.put(*(frame_at(k, people=True) for k in range(5)), None)
            assert eventually(lambda: thread.state is SensorState.ENDED)
            publish_until(thread, published, threading.Event(), lambda event: told.append(event.text))
        assert published.published == 5
        frames = far.frames()
        assert [next(frames).time_ns for _ in range(5)] == [0, 1, 2, 3, 4]
    assert told == []


@contextmanager
def remote_after(opening, address):
    """A publisher and a remote sensor that receives its frames."""
    with opening as published, remote(address) as far:

        def heard():
            return bool(published._publisher.matching_status.matching)

        assert eventually(heard)
        yield published, far


def test_a_clock_request_without_content_is_counted(address):
    with publisher(address) as published, zenoh_session(ZenohAddresses(connect=(address,))) as session:

        def counted():
            assert not list(session.get(f"{KEY}/{CLOCK}", timeout=1.0))
            return published.malformed > 0

        assert eventually(counted)
