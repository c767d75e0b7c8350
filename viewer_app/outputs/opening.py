"""Opens the outputs that the options ask for, and reports their counts."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from urllib.parse import urlsplit

import numpy as np
from rich.console import Console

from fusion.body import Body
from fusion.movement.angles import UP
from fusion.setup import FusionSetup
from recordings.gait.events import find_gait
from viewer_app.addresses import is_loopback, print_code
from viewer_app.errors import UsageError
from viewer_app.options.shared import LiveOutputOptions
from viewer_app.outputs.avatars.osc import Address, OscOutput, looked_up
from viewer_app.outputs.avatars.vmc import VmcEncoder
from viewer_app.outputs.avatars.vrchat import VRChatEncoder
from viewer_app.outputs.avatars.vrm import Avatar, read_avatar
from viewer_app.outputs.even_samples import EvenSamples
from viewer_app.outputs.output import LiveOutput

_VMC_PORT, _VRCHAT_PORT = 39539, 9000  # the usual ones of the receivers


@dataclass(frozen=True)
class OutputPlan:
    """The outputs that the options ask for, checked."""

    options: LiveOutputOptions
    listen: str | None  # address for servers; None for this machine only
    vmc: Address | None  # receivers
    vrchat: Address | None
    avatar: Avatar | None  # proportions for VMC
    overwrite: bool  # files that exist

    def __bool__(self) -> bool:
        """Whether there is any output."""
        return _any(self.options)

    def warm_up(self, body: Body) -> None:
        """Compiles and loads what the outputs need before the first frame."""
        if self:
            find_gait(body, [0], np.full((1, len(body), 3), np.nan), UP)
            from viewer_app.outputs.avatars.unity_pose import UnitySkeleton

            joints = np.zeros((len(body), 3))
            for joint in body.order[1:]:
                joints[joint] = joints[body.parents[joint]] + body.nominal_lengths[joint] * body.rest[joint]
            skeleton = UnitySkeleton(body)
            skeleton.update(joints, 0)  # each kernel is compiled for one set of types

    @contextmanager
    def opened(self, setup: FusionSetup, rate: float) -> Iterator[Sequence[LiveOutput]]:
        """Opens the outputs; closes them at the end of the block."""
        self.warm_up(setup.body)
        with ExitStack() as stack:
            outputs = []
            for output in self._open(setup, self.options.rate or rate):
                stack.callback(output.close)
                if self.options.rate is not None:
                    output.even = EvenSamples(setup.body, self.options.rate)
                outputs.append(output)
            yield outputs

    def _open(self, setup: FusionSetup, rate: float) -> Iterator[LiveOutput]:
        options, body = self.options, setup.body
        feet_of = body if options.feet == "planted" else None
        if self.vmc is not None:
            vmc = VmcEncoder(body, self.avatar).encode
            yield OscOutput(f"VMC to {self.vmc}", self.vmc, "--vmc", vmc, feet_of)
        if self.vrchat is not None:
            vrchat = VRChatEncoder(body).encode
            yield OscOutput(f"VRChat at {self.vrchat}", self.vrchat, "--vrchat", vrchat, feet_of)
        if options.lsl is not None:
            from viewer_app.outputs.lab_streaming import LabStreamingOutput

            yield LabStreamingOutput(options.lsl, body, rate, others=self.listen is not None)
        if options.websocket is not None:
            from viewer_app.outputs.websocket import WebSocketOutput

            yield WebSocketOutput(options.websocket, setup, self.listen)
        if options.zenoh is not None:
            from devices.network.zenoh_session import ZenohAddresses
            from viewer_app.outputs.zenoh_topic import ZenohOutput

            addresses = ZenohAddresses.of_meeting_point(options.zenoh_listen, options.zenoh_connect)
            yield ZenohOutput(options.zenoh, addresses, setup)
        if options.save_mcap is not None:
            from viewer_app.outputs.mcap_file import McapOutput

            yield McapOutput(options.save_mcap, setup, self.overwrite)


def _any(options: LiveOutputOptions) -> bool:
    """Whether there is any output."""
    wanted = (options.vmc, options.vrchat, options.lsl, options.websocket, options.zenoh, options.save_mcap)
    return any(each is not None for each in wanted)


def plan_outputs(
    options: LiveOutputOptions,
    listen: str | None = None,
    remote_sensors: bool = False,
    overwrite: bool = False,
) -> OutputPlan:
    """Checks the options of the outputs and reads the avatar; opens nothing.

    Args:
        listen: Address of this machine for receivers on other machines; None: this machine only.
        remote_sensors: Whether the Zenoh addresses are used by sensors as well.
        overwrite: Whether files that exist are overwritten.
    """
    vmc = None if options.vmc is None else Address.of(options.vmc, "--vmc", _VMC_PORT)
    vrchat = None if options.vrchat is None else Address.of(options.vrchat, "--vrchat", _VRCHAT_PORT)
    for address, option in ((vmc, "--vmc"), (vrchat, "--vrchat")):
        if address is not None:
            looked_up(address, option)
    if options.rate is not None and not _any(options):
        raise UsageError(
            "--rate is for --vmc, --vrchat, --lsl, --websocket, --zenoh and --save-mcap; give one of them."
        )
    if options.rate is not None and not 1.0 <= options.rate <= 240.0:
        raise UsageError(f"--rate {options.rate:g}: a rate is 1 to 240 samples per second.")
    if options.websocket is not None and not 0 < options.websocket < 65536:
        raise UsageError(f"--websocket {options.websocket}: a port is between 1 and 65535.")
    if options.lsl is not None:
        from viewer_app.outputs.lab_streaming import load_pylsl

        if not options.lsl.strip():
            raise UsageError("--lsl needs a name for the stream.")
        load_pylsl(others=listen is not None)
    if options.zenoh is not None:
        from devices.network.zenoh_session import ZenohAddresses, checked_key, load_zenoh

        load_zenoh()
        checked_key(options.zenoh)
        ZenohAddresses.of_meeting_point(options.zenoh_listen, options.zenoh_connect)
    elif (options.zenoh_listen or options.zenoh_connect) and not remote_sensors:
        raise UsageError("--zenoh-listen and --zenoh-connect are addresses for --zenoh; give its key too.")
    if options.save_mcap is not None:
        from recordings.export import check_packages

        if options.save_mcap.suffix.lower() != ".mcap":
            example = options.save_mcap.with_suffix(".mcap").name
            raise UsageError(f"--save-mcap {options.save_mcap}: the name must end in .mcap, as in {example}.")
        check_packages(".mcap")
    avatar = None if options.avatar is None else read_avatar(options.avatar)
    return OutputPlan(options, listen, vmc, vrchat, avatar, overwrite)


def announce_outputs(console: Console, outputs: Sequence[LiveOutput]) -> None:
    """Prints where S* is sent."""
    for output in outputs:
        where = f"{output.name}; page: {output.page}" if output.page else output.name
        console.print(f"Sending: {where}", markup=False, soft_wrap=True)
        if output.note:
            console.print(output.note, style="yellow", markup=False, soft_wrap=True)
        if output.page and not is_loopback(urlsplit(output.page).hostname):
            print_code(output.page, console)


def print_outputs(console: Console, outputs: Sequence[LiveOutput]) -> None:
    """Prints the counts of each output, whom it refused, and why one stopped."""
    for output in outputs:
        counts = output.counts
        said = f"{output.name}: frames sent {counts.sent}, dropped {counts.dropped}, late {counts.late}."
        console.print(said, markup=False, soft_wrap=True)
        for why in filter(None, (output.warning, None if output.keeps else output.failure)):
            console.print(why, style="yellow", markup=False, soft_wrap=True)


def check_kept(outputs: Sequence[LiveOutput]) -> None:
    """Reports a file that is not whole as a usage error: one line and exit code 2."""
    for output in outputs:
        if output.keeps and output.failure is not None:
            raise UsageError(output.failure)
