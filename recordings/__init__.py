"""Sessions, in memory and on disk: ``from recordings import Session, fuse``."""

from typing import TYPE_CHECKING

from fusion.support.lazy_names import lazy_names

if TYPE_CHECKING:
    from devices.events import Event as Event
    from recordings.comparing.session_comparison import Comparison as Comparison
    from recordings.comparing.truth_comparison import TruthComparison as TruthComparison
    from recordings.data.series import AngleSeries as AngleSeries
    from recordings.data.series import QualitySeries as QualitySeries
    from recordings.data.series import RotationSeries as RotationSeries
    from recordings.data.series import SkeletonSeries as SkeletonSeries
    from recordings.data.session_arrays import SessionArrays as SessionArrays
    from recordings.data.session_arrays import SessionFrame as SessionFrame
    from recordings.errors import MissingFileError as MissingFileError
    from recordings.errors import RecordingError as RecordingError
    from recordings.errors import UnknownNameError as UnknownNameError
    from recordings.file_fusion import fuse as fuse
    from recordings.file_fusion import fuse_arrays as fuse_arrays
    from recordings.gait import Gait as Gait
    from recordings.gait import Step as Step
    from recordings.gait import Turn as Turn
    from recordings.live_fusion import fuse_live as fuse_live
    from recordings.quality.per_second import SecondQuality as SecondQuality
    from recordings.quality.verdict import Verdict as Verdict
    from recordings.session import Session as Session

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
