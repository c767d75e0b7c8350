"""The queue of a sink: what does not fit gives way as the policy says, and nothing else."""

from collections import deque

from hypothesis import given
from hypothesis import strategies as st

from devices.events import Event
from viewer_app.sinks import item_queue
from viewer_app.sinks.item_queue import DropOldest, QueuedFrame


@given(keep=st.integers(1, 5), kinds=st.lists(st.booleans(), max_size=40), others=st.integers(1, 6))
def test_the_newest_frames_and_events_are_kept_in_order_and_lost_frames_counted(keep, kinds, others):
    policy, queued, put = DropOldest(keep), deque(), []
    limit, item_queue._KEPT_OTHERS = item_queue._KEPT_OTHERS, others
    try:
        for k, is_frame in enumerate(kinds):
            item = QueuedFrame(k, None, k, k) if is_frame else Event(str(k))
            put.append(item)
            queued.append(policy(queued, item))
    finally:
        item_queue._KEPT_OTHERS = limit
    frames = [item for item in put if isinstance(item, QueuedFrame)]
    events = [item for item in put if isinstance(item, Event)]
    kept = {id(item) for item in (*frames[-keep:], *events[-others:])}
    assert [id(item) for item in queued] == [id(item) for item in put if id(item) in kept]
    assert policy.dropped == max(len(frames) - keep, 0)
