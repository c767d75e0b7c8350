"""The page of the public names: which ones, in which order. The entries are made from the docstrings."""

_ABOUT = """# Python reference

Import a name from the package in its heading: `from recordings import Session`. These names are public: they
stay within one major version, or change with a note in [Upgrading](upgrading.md). Anything else may change.
"""
_TOPICS: tuple[tuple[str, str, str, str], ...] = (
    (
        "Sessions",
        "What `fuse`, `fuse_arrays` and `Session.open` return, and what a session gives.",
        "recordings",
        "Session SkeletonSeries QualitySeries AngleSeries RotationSeries Gait Step Turn Verdict "
        "SecondQuality Comparison TruthComparison Event SessionArrays SessionFrame",
    ),
    (
        "Fusing",
        "",
        "",
        "recordings.fuse recordings.fuse_arrays recordings.fuse_live recordings.live_fusion.LiveFrames",
    ),
    (
        "Tests",
        "`from recordings.testing import …`. The fixture `simulated_session` needs no import.",
        "recordings.testing",
        "assert_session assert_sessions_match simulated_session",
    ),
    (
        "The method on arrays",
        "",
        "fusion",
        "Fuser FusedFrame FusionSetup FuserSettings Calibration calibrate nominal_calibration Calibrator "
        "StartUpPose find_start_up_pose Skeleton SkeletonPair TrackingState Body BODIES KINECT_V1 "
        "KINECT_V2 AZURE_KINECT BLAZEPOSE RigidTransform Intrinsics Clock",
    ),
    (
        "Sensors and recordings",
        "",
        "devices",
        "Sensor SensorFrame ColorImage ColorCamera DepthCamera TwoSensors simulated_pair open_source "
        "read_two TwoRecordings RecordingChoice FramePair Pairing pair_views",
    ),
    (
        "Exceptions",
        "All have the base `DuplexError`. Its message is one line: what happened, the value, and what to do.",
        "",
        "fusion.DuplexError fusion.FusionError fusion.BodyError fusion.CalibrationError "
        "devices.DeviceError devices.MissingRecordingError recordings.RecordingError "
        "devices.output_file.OutputError recordings.MissingFileError recordings.UnknownNameError "
        "recordings.testing.SessionsDifferError",
    ),
    (
        "Names with a module of their own",
        "These are public under the path in the heading.",
        "",
        "devices.blazepose.settings.BlazePoseSettings devices.network.publishing.FramePublisher "
        "devices.network.zenoh_session.ZenohAddresses fusion.movement.angles "
        "fusion.movement.joint_rotations",
    ),
    (
        "Values that are returned",
        "These are documented for reading. Do not import them: their modules may change.",
        "",
        "recordings.data.session_data.ViewsAgree devices.findings.finding.Finding "
        "recordings.data.series.PersonSpan recordings.quality.per_second.Span recordings.data.images.Images "
        "devices.events.Spell devices.people.recorded_people.SeenPerson devices.frame_pairs.RecordedPairs "
        "fusion.registration.rigid_fit.Registration",
    ),
)
"""Title, introduction, package and names of each section; without a package, names with their module."""


def api_page() -> str:
    """Markdown: an entry of mkdocstrings for each name."""
    parts = [_ABOUT]
    for title, about, package, names in _TOPICS:
        entries = [f"::: {package}.{name}" if package else f"::: {name}" for name in names.split()]
        parts.append("\n\n".join([f"## {title}", *filter(None, [about]), *entries, ""]))
    return "\n".join(parts)
