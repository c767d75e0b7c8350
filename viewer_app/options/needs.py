"""Which options need which others: one that would have no effect is refused, by every command alike."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from viewer_app.errors import UsageError
from viewer_app.options.sensing import (
    BatchOptions,
    DemoOptions,
    DoctorOptions,
    FuseOptions,
    ImageFilesOptions,
    LiveOptions,
    PublishOptions,
)
from viewer_app.options.sessions import ReviewOptions
from viewer_app.options.shared import (
    FusionOptions,
    LiveOutputOptions,
    RecordingOptions,
    TerminalOptions,
    TrackerOptions,
    ViewerOptions,
    calibration_is_file,
)

_STATED = ("unit", "axes", "names")
_OF_SIDES = tuple(f"{name}_{side}" for name in _STATED for side in "ab")
_TRACKER = ("tracker", "tracker_model", "tracker_network", "k4abt", "processing")


@dataclass(frozen=True)
class Need:
    """What some options need to have an effect.

    Attributes:
        kind: The commands that have the options.
        options: Their names.
        met: Whether the need is met.
        what: It in words, after ``--option``.
    """

    kind: type
    options: tuple[str, ...]
    met: Callable[[Any], bool]
    what: str


def _reads_images(options: Any) -> bool:
    """Whether a recording of images is among the files, or a sensor runs."""
    from devices.recorded.files import (
        has_images,  # as below: these commands take it anyway, the others need not wait
    )

    files = _files(options, "a", "b", "recording")
    return not files or any(map(has_images, files))


def _reads_csv(options: Any) -> bool:
    names = "a", "b", "skeletons_a", "skeletons_b", "recording"
    return any(path.suffix.lower() == ".csv" for path in _files(options, *names))


def _files(options: Any, *names: str) -> list[Path]:
    """The files that some options name."""
    return [path for path in (getattr(options, name, None) for name in names) if path is not None]


def _tracks_images(options: FuseOptions) -> bool:
    """Whether one of the recordings is of images, without skeletons saved before."""
    from devices.recorded.files import has_images

    given = (options.a, options.skeletons_a), (options.b, options.skeletons_b)
    return any(has_images(path) and saved is None for path, saved in given)


def _all_remote(options: LiveOptions) -> bool:
    from devices.network.remote_sensor import PREFIX

    return all((name or "").startswith(PREFIX) for name in (options.kinect_a, options.kinect_b))


def _writes_or_shows(options: Any) -> bool:
    return not options.no_viewer or options.save is not None


def _asks_for_k4abt(options: TrackerOptions) -> bool:
    return options.tracker == "k4abt" or (options.tracker == "auto" and options.k4abt is not None)


def _runs_a_sensor(options: PublishOptions) -> bool:
    return options.recording is None and options.simulate is None


NEEDS = (
    Need(
        FusionOptions, ("h", "weights"), lambda o: o.method != "duplex", "needs --method paper or published"
    ),
    Need(
        FusionOptions,
        ("smoothing", "smooth", "no_refine"),
        lambda o: o.method == "duplex",
        "needs --method duplex",
    ),
    Need(
        RecordingOptions,
        ("no_refine",),
        lambda o: not calibration_is_file(o.calibrate),
        "needs another --calibrate; a calibration from a file is kept",
    ),
    Need(FuseOptions, ("depth",), _reads_images, "needs a recording of images: .mkv, .db3 or .bag"),
    Need(FuseOptions, _TRACKER, _tracks_images, "needs a recording of images without saved skeletons"),
    Need(
        FuseOptions, ("person",), _tracks_images, "needs images; for skeletons, use --person-a and --person-b"
    ),
    Need(FuseOptions, ("depth",), _writes_or_shows, "needs a viewer, or --save FILE.rrd"),
    Need(FuseOptions, _STATED + _OF_SIDES, _reads_csv, "needs a .csv file"),
    Need(BatchOptions, ("processes",), lambda o: o.scheduler is None, "cannot be used with --scheduler"),
    Need(PublishOptions, ("motion", "body"), lambda o: o.simulate is not None, "needs --simulate"),
    Need(PublishOptions, _STATED, lambda o: o.recording is not None, "needs --recording"),
    Need(PublishOptions, _STATED, _reads_csv, "needs a .csv file"),
    Need(PublishOptions, ("depth_mode", "fps"), _runs_a_sensor, "needs a sensor on this PC"),
    Need(
        PublishOptions,
        (*_TRACKER, "person", "depth", "orientation"),
        lambda o: o.simulate is None and _reads_images(o),
        "needs a sensor, or a recording of images",
    ),
    Need(ImageFilesOptions, ("compress",), lambda o: o.record is not None, "needs --record FOLDER"),
    Need(DemoOptions, ("other",), lambda o: o.people > 1, "needs --people 2"),
    Need(
        DemoOptions,
        ("tracker_model", "tracker_network"),
        lambda o: o.tracker == "blazepose",
        "needs --tracker blazepose",
    ),
    Need(
        LiveOptions,
        ("fps", "depth_mode"),
        lambda o: o.a is None and not _all_remote(o),
        "needs sensors on this PC, not recordings",
    ),
    Need(
        LiveOptions,
        ("color", "orientation"),
        lambda o: not _all_remote(o),
        "needs sensors on this PC, or recordings",
    ),
    Need(DoctorOptions, ("force",), lambda o: o.bundle is not None, "needs --bundle FILE.zip"),
    Need(LiveOptions, _TRACKER, lambda o: not _all_remote(o), "needs a sensor on this PC, or recordings"),
    # after all of a command that has no use for a body tracker
    Need(
        TrackerOptions, ("k4abt", "processing"), lambda o: o.tracker != "blazepose", "needs another --tracker"
    ),
    Need(
        TrackerOptions,
        ("tracker_model", "tracker_network", "person"),
        lambda o: not _asks_for_k4abt(o),
        "needs --tracker blazepose",
    ),
    Need(
        DoctorOptions, ("person",), lambda _: False, "needs a command that follows a person; doctor does not"
    ),
    Need(ViewerOptions, ("layout",), _writes_or_shows, "needs a viewer, or --save FILE.rrd"),
    Need(
        DemoOptions,
        ("layout",),
        lambda o: not o.bad_setup,
        "cannot be used with --bad-setup, which opens the setup tab",
    ),
    Need(
        DemoOptions,
        tuple(each.name for each in fields(DemoOptions) if each.name != "motion"),
        lambda o: o.motion != "list",
        "needs a movement; --motion list only lists them",
    ),
    Need(ReviewOptions, ("event", "at"), lambda o: not o.no_viewer, "needs a viewer"),
    Need(LiveOutputOptions, ("avatar",), lambda o: o.vmc is not None, "needs --vmc"),
    Need(
        LiveOutputOptions,
        ("feet",),
        lambda o: o.vmc is not None or o.vrchat is not None,
        "needs --vmc or --vrchat",
    ),
    Need(TerminalOptions, ("verbose",), lambda o: not o.quiet, "cannot be used with --quiet"),
)


def without_effect(options: Any) -> dict[str, str]:
    """The options of a command line whose need is not met, and what each needs."""
    usual = {each.name: each.default for each in fields(options)}
    found: dict[str, str] = {}
    for need in NEEDS:
        if isinstance(options, need.kind) and not need.met(options):
            for name in need.options:
                if name in usual and getattr(options, name) != usual[name]:
                    found.setdefault(name, need.what)
    return found


def refuse_without_effect(*lines: Any) -> None:
    """Refuses an option that has no effect on any of some command lines, of which each has it.

    Raises:
        UsageError: There is one; it names the first.
    """
    first, *others = map(without_effect, lines)
    for name, what in first.items():
        if all(name in other for other in others):
            raise UsageError(f"--{name.replace('_', '-')} {what}.")
