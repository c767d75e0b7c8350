"""An output never delays the loop: its queue is bounded, the oldest frames are dropped and counted."""

import socket
import threading
from collections import deque
from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from devices.events import Event
from tests.helpers.live_frames import BODY, frames
from tests.helpers.osc import messages
from tests.helpers.waiting import eventually
from viewer_app.outputs.avatars.osc import Address, OscOutput
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.even_samples import EvenSamples
from viewer_app.outputs.output import LATE_NS, LiveOutput, _Presence, confidence
from viewer_app.sinks.item_queue import QueuedFrame


class Receiver(LiveOutput):
    """An output whose receiver takes a frame only when the test permits it."""

    def __init__(self, keep=1):
        super().__init__("Receiver of a test", keep, clock=lambda: self.now_ns)
        self.now_ns = 0
        self.let, self.taking = threading.Semaphore(0), threading.Semaphore(0)
        self.got = []
        self.said = []
        self.refuses = self.breaks = False
        self.start()

    def send_frame(self, frame):
        self.taking.release()
        self.let.acquire()
        if self.breaks:
            raise ValueError("a fault of the program")
        if self.refuses:
            raise OSError("network unreachable")
        self.got.append(frame.number)
        return 1

    def send_event(self, event):
        self.said.append(event.text)


def test_a_blocked_receiver_loses_the_oldest_frames(fuser):
    output = Receiver(keep=3)
    made = frames(fuser, 50)
    output.write(made[0])
    assert output.taking.acquire(timeout=10)  # the thread has frame 0 and waits
    for frame in made[1:]:
        output.write(frame)  # none of these waits: the thread stands still all the while
    assert output.counts.dropped == 49 - 3
    for _ in range(4):
        output.let.release()
    assert eventually(lambda: output.got == [0, 47, 48, 49])
    output.close()
    assert output.counts.sent == 4


def test_lateness_is_counted(fuser):
    output = Receiver()
    for k, (frame, age) in enumerate(zip(frames(fuser, 2), (LATE_NS, LATE_NS + 1), strict=True)):
        output.write(frame)
        assert output.taking.acquire(timeout=10)
        output.now_ns += age
        output.let.release()
        assert eventually(lambda k=k: output.counts.sent == k + 1)
    output.close()
    assert output.counts.late == 1


def test_a_candidate_that_the_network_rejects_is_dropped_and_the_next_is_tried(fuser):
    output = Receiver(keep=8)
    output.refuses = True
    for frame in frames(fuser, 3):
        output.write(frame)
        output.let.release()
    assert eventually(lambda: output.counts.dropped == 3)
    output.refuses = False
    output.let.release()
    output.write(frames(fuser, 1)[0])
    output.close()
    assert output.counts.sent == 1
    assert output.failure is None


@given(kinds=st.lists(st.tuples(st.booleans(), st.sampled_from(["sent", "refused", "nobody"])), max_size=12))
def test_every_frame_is_sent_or_dropped_and_an_event_is_neither(fuser, kinds):
    """Whatever the network refuses; without a receiver there is nothing to count."""
    todo = deque(outcome for _, outcome in kinds)

    class Output(LiveOutput):
        def send_frame(self, _):
            outcome = todo.popleft()
            if outcome == "refused":
                raise OSError("network unreachable")
            return 1 if outcome == "sent" else None

        def send_event(self, _):
            self.send_frame(None)

    output, (frame,) = Output("x", keep=20), frames(fuser, 1)
    for is_frame, _ in kinds:
        if is_frame:
            output.write(frame)
        else:
            output.event(Event("something"))
    output.start()
    output.close()
    counts, of_frames = output.counts, [outcome for is_frame, outcome in kinds if is_frame]
    assert (counts.sent, counts.dropped) == (of_frames.count("sent"), of_frames.count("refused"))
    assert output.failure is None


def test_a_fault_ends_the_output_and_not_the_session(fuser):
    output = Receiver()
    output.breaks = True
    output.let.release()
    output.write(frames(fuser, 1)[0])
    assert eventually(lambda: output.failure is not None)
    assert "ValueError: a fault of the program" in str(output.failure)
    for frame in frames(fuser, 3):
        output.write(frame)
    output.close()
    output.close()  # again: no effect


def test_events_are_not_dropped_with_the_frames(fuser):
    output = Receiver()
    for k, frame in enumerate(frames(fuser, 20)):
        output.write(frame)
        output.event(Event(f"event {k}"))
    for _ in range(20):
        output.let.release()
    assert eventually(lambda: len(output.said) == 20)
    output.close()


def test_confidence_falls_with_the_standard_deviation(fuser):
    fused = frames(fuser, 3)[-1].fused
    trust = confidence(fused)
    assert ((trust > 0.0) & (trust < 1.0)).all()
    order = np.argsort(fused.sigma)
    assert (np.diff(trust[order]) <= 0.0).all()
    half = replace(fused, sigma=np.full(len(trust), 0.05))
    np.testing.assert_allclose(confidence(half), 0.5, rtol=1e-12)
    nobody = replace(fused, positions=np.full_like(fused.positions, np.nan))
    assert (confidence(nobody) == 0.0).all()
    paper = replace(fused, sigma=None, predicted=np.arange(len(trust)) == 4)
    assert sorted(set(confidence(paper).tolist())) == [0.25, 1.0]


def with_person(frame, present):
    positions = np.full_like(frame.fused.positions, 0.0 if present else np.nan)
    return replace(frame, fused=replace(frame.fused, positions=positions))


@given(present=st.lists(st.booleans(), min_size=1, max_size=60))
def test_a_person_leaves_after_half_a_second_and_returns(fuser, present):
    template = frames(fuser, 1)[0]
    presence, missing, gone, seen = _Presence(), 0, False, False
    for k, there in enumerate(present):
        queued = QueuedFrame(k, with_person(template, there), k * 100_000_000, 0)
        news = presence.news(queued)
        missing, seen = 0 if there else missing + 1, seen or there
        expected = "person returned" if there and gone else ""
        gone = gone and not there
        if seen and missing == 5:
            expected, gone = "person left", True
        assert (news.text if news else "") == expected


def test_that_no_frames_come_is_said_once_until_they_come_again(fuser):
    class Quiet(Receiver):
        silent = ()

        def send_silence(self, time_ns):
            self.silent += (time_ns,)

    output, made = Quiet(), frames(fuser, 2)
    output.let.release(2)
    output.write(made[0])
    assert eventually(lambda: output.got == [0])
    output.now_ns = 1_000_000_000
    assert eventually(lambda: output.said == ["no frames for 1 s"])
    output.now_ns = 9_000_000_000
    output.write(made[1])
    assert eventually(lambda: output.got == [0, 1])
    assert output.silent == (1_000_000_000,)  # since the first frame
    output.close()
    assert len(output.silent) == 2  # the end
    assert output.said == ["no frames for 1 s"]


def test_at_an_even_rate_too_it_is_said_that_no_frames_come(fuser):
    output = Receiver()
    output.even = EvenSamples(BODY, 10.0)
    output.let.release(4)
    output.write(frames(fuser, 1)[0])
    assert eventually(lambda: output.got == [0])
    output.now_ns = 400_000_000
    assert eventually(lambda: output.got == [0, 1, 2, 3])  # S* is not predicted farther ahead
    output.now_ns = 1_000_000_000
    assert eventually(lambda: output.said == ["no frames for 1 s"])
    output.close()


def test_the_last_word_of_vmc_is_that_nobody_is_tracked(fuser):
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(10.0)
        address = Address("127.0.0.1", receiver.getsockname()[1])
        frame = frames(fuser, 1)[0]
        output = OscOutput("VMC", address, "--vmc", VmcEncoder(BODY).encode)
        output.write(frame)
        output.close()
        said = []
        while not said or said[-1] != ("/VMC/Ext/OK", [1, 3, 0, 0]):
            said += [m for m in messages([receiver.recv(2000)]) if m[0] == "/VMC/Ext/OK"]
