"""The method: two skeletons in, one out. It knows neither files nor devices."""

from typing import TYPE_CHECKING

from fusion.support.lazy_names import lazy_names

if TYPE_CHECKING:
    from fusion.body import AZURE_KINECT as AZURE_KINECT
    from fusion.body import BLAZEPOSE as BLAZEPOSE
    from fusion.body import BODIES as BODIES
    from fusion.body import KINECT_V1 as KINECT_V1
    from fusion.body import KINECT_V2 as KINECT_V2
    from fusion.body import Body as Body
    from fusion.calibration.calibration import Calibration as Calibration
    from fusion.calibration.calibration import calibrate as calibrate
    from fusion.calibration.calibration import nominal_calibration as nominal_calibration
    from fusion.calibration.calibrator import Calibrator as Calibrator
    from fusion.calibration.start_up_pose import StartUpPose as StartUpPose
    from fusion.calibration.start_up_pose import find_start_up_pose as find_start_up_pose
    from fusion.clocks import Clock as Clock
    from fusion.errors import BodyError as BodyError
    from fusion.errors import CalibrationError as CalibrationError
    from fusion.errors import DuplexError as DuplexError
    from fusion.errors import FusionError as FusionError
    from fusion.fused_frame import FusedFrame as FusedFrame
    from fusion.fuser import Fuser as Fuser
    from fusion.intrinsics import Intrinsics as Intrinsics
    from fusion.rigid import RigidTransform as RigidTransform
    from fusion.setup import FuserSettings as FuserSettings
    from fusion.setup import FusionSetup as FusionSetup
    from fusion.skeleton import Skeleton as Skeleton
    from fusion.skeleton import SkeletonPair as SkeletonPair
    from fusion.skeleton import TrackingState as TrackingState

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
