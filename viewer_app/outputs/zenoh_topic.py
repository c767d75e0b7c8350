"""S* over Zenoh: the JSON of the WebSocket under ``KEY/hello``, ``KEY/frame`` and ``KEY/event``."""

from contextlib import ExitStack

from devices.events import Event
from devices.network.zenoh_session import ZenohAddresses, checked_key, load_zenoh, zenoh_session
from fusion.setup import FusionSetup
from viewer_app.addresses import zenoh_warning
from viewer_app.outputs.output import LiveOutput
from viewer_app.outputs.skeleton_json import SkeletonJson
from viewer_app.sinks.item_queue import QueuedFrame

_KEEP = 64
_HELLO_EVERY_NS = 1_000_000_000  # for those who come later


class ZenohOutput(LiveOutput):
    """Publishes S*; a message that a congested link does not take at once is dropped by Zenoh."""

    def __init__(self, key: str, addresses: ZenohAddresses, setup: FusionSetup) -> None:
        super().__init__(f"Zenoh key {key}", keep=_KEEP)
        self.note = zenoh_warning(addresses.listen)
        self._key, self._setup = checked_key(key), setup
        self._json = SkeletonJson(setup)
        self._opened = ExitStack()
        self._fault = load_zenoh().ZError
        self._session = self._opened.enter_context(zenoh_session(addresses))
        self._hello_ns = 0
        self.start()

    def send_frame(self, frame: QueuedFrame) -> int:
        """Publishes a frame, and once a second the description."""
        if frame.time_ns >= self._hello_ns:
            self._hello_ns = frame.time_ns + _HELLO_EVERY_NS
            self.send_setup(self._setup)
        self._put("frame", self._json.frame(frame))
        for event in self._json.gait_events():
            self.send_event(event)
        return 1

    def send_event(self, event: Event) -> None:
        self._put("event", self._json.event(event))

    def send_setup(self, setup: FusionSetup) -> None:
        """Publishes the description."""
        self._setup = setup
        self._put("hello", self._json.hello(setup))

    def shut(self) -> None:
        """Closes the session, unless others use it."""
        self._opened.close()

    def _put(self, topic: str, text: str) -> None:
        try:
            self._session.put(f"{self._key}/{topic}", text.encode())
        except self._fault as fault:
            raise OSError(str(fault)) from fault
