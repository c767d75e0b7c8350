"""Which options need which others: one that would have no effect is refused, by every command alike."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

from viewer_app.errors import UsageError
from viewer_app.options.sensing import (
    BatchOptions,
    DemoOptions,
    DoctorOptions,
    FuseOptions,
    LiveOptions,
    PublishOptions,
)
from viewer_app.options.shared import FusionOptions, LiveOutputOptions, TerminalOptions

_TRACKER = ("tracker", "tracker_model", "tracker_network", "k4abt", "processing")


@dataclass(frozen=True)
class Need:
    """What some options need to have an effect.

    Attributes:
        kind: The commands that have the options.
        options: Their names.
        met: Whether the need is met.
        what: It in words, after ``--option needs``.
    """

    kind: type
    options: tuple[str, ...]
    met: Callable[[Any], bool]
    what: str


def _reads_images(options: Any) -> bool:
    """Whether a recording of images is among the files, or a sensor runs."""
    from devices.files import has_images  # as below: these commands take it anyway, the others need not wait

    named = [getattr(options, name, None) for name in ("a", "b", "recording")]
    files = [path for path in named if path is not None]
    return not files or any(map(has_images, files))


def _tracks_images(options: FuseOptions) -> bool:
    """Whether one of the recordings is of images, without skeletons saved before."""
    from devices.files import has_images

    given = (options.a, options.skeletons_a), (options.b, options.skeletons_b)
    return any(has_images(path) and saved is None for path, saved in given)


def _all_remote(options: LiveOptions) -> bool:
    from devices.network.remote_sensor import PREFIX

    return all((name or "").startswith(PREFIX) for name in (options.kinect_a, options.kinect_b))


def _runs_a_sensor(options: PublishOptions) -> bool:
    return options.recording is None and options.simulate is None


NEEDS = (
    Need(FusionOptions, ("h", "weights"), lambda o: o.method != "duplex", "--method paper or published"),
    Need(
        FusionOptions, ("smoothing", "smooth", "no_refine"), lambda o: o.method == "duplex", "--method duplex"
    ),
    Need(FuseOptions, ("depth",), _reads_images, "a recording of images: .mkv, .db3 or .bag"),
    Need(FuseOptions, _TRACKER, _tracks_images, "a recording of images without saved skeletons"),
    Need(
        FuseOptions, ("person",), _tracks_images, "images; for skeletons there are --person-a and --person-b"
    ),
    Need(BatchOptions, ("processes",), lambda o: o.scheduler is None, "no --scheduler"),
    Need(PublishOptions, ("motion", "body"), lambda o: o.simulate is not None, "--simulate"),
    Need(PublishOptions, ("unit", "axes", "names"), lambda o: o.recording is not None, "--recording"),
    Need(PublishOptions, ("depth_mode", "fps"), _runs_a_sensor, "a sensor of this PC"),
    Need(
        PublishOptions,
        (*_TRACKER, "person", "depth"),
        lambda o: o.simulate is None and _reads_images(o),
        "a sensor, or a recording of images",
    ),
    Need(LiveOptions, ("compress",), lambda o: o.record is not None, "--record FOLDER"),
    Need(DemoOptions, ("compress",), lambda o: o.record is not None, "--record FOLDER"),
    Need(
        DemoOptions,
        ("tracker_model", "tracker_network"),
        lambda o: o.tracker == "blazepose",
        "--tracker blazepose",
    ),
    Need(
        LiveOptions,
        ("fps", "depth_mode"),
        lambda o: o.a is None and not _all_remote(o),
        "sensors of this PC, no recordings",
    ),
    Need(LiveOptions, ("color",), lambda o: not _all_remote(o), "sensors of this PC, or recordings"),
    Need(DoctorOptions, ("force",), lambda o: o.bundle is not None, "--bundle FILE.zip"),
    Need(LiveOptions, _TRACKER, lambda o: not _all_remote(o), "a sensor of this PC, or recordings"),
    Need(LiveOutputOptions, ("avatar",), lambda o: o.vmc is not None, "--vmc"),
    Need(TerminalOptions, ("verbose",), lambda o: not o.quiet, "no --quiet"),
)


def refuse_without_effect(options: Any) -> None:
    """Refuses a command line with an option whose need is not met.

    Raises:
        UsageError: One is not; it names the first.
    """
    usual = {each.name: each.default for each in fields(options)}
    for need in NEEDS:
        if isinstance(options, need.kind) and not need.met(options):
            for name in need.options:
                if name in usual and getattr(options, name) != usual[name]:
                    raise UsageError(f"--{name.replace('_', '-')} needs {need.what}.")
