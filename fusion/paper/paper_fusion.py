"""The paper's methods: owns their arrays and returns the results as fused frames."""

from fusion.body import KINECT_V2
from fusion.calibration.calibration import nominal_calibration
from fusion.compiling.kernels import compiles
from fusion.compiling.references import by_reference
from fusion.fused_frame import FusedFrames
from fusion.pair_arrays import PairArrays, PairStacker
from fusion.paper import method
from fusion.rigid import RigidTransform
from fusion.setup import FuserSettings, FusionSetup, Method
from fusion.skeleton import SkeletonPair
from fusion.support.array_fields import new_arrays


class PaperFusion:
    """``paper`` and ``published``; see :class:`fusion.setup.FuserSettings`."""

    def __init__(self, setup: FusionSetup) -> None:
        self._memory = by_reference(new_arrays(method.Memory, J=len(setup.body)))
        self.recalibrate(setup)

    def recalibrate(self, setup: FusionSetup) -> None:
        """Continues with another calibration."""
        self._setup = setup
        self._model = by_reference(method.new_model(setup))
        self._memory.translation[:] = setup.calibration.a_from_b.translation

    def run(self, pairs: PairArrays) -> FusedFrames:
        """Fuses the next pairs. The paper uses neither skew, nor exchanged sides, nor images."""
        result = new_arrays(method.Result, T=len(pairs.time_ns), J=pairs.a.shape[1])
        published = self._setup.settings.method == "published"
        fuse = method.fuse_frames_as_published if published else method.fuse_frames
        fuse(self._model, self._memory, result, pairs)
        a_from_b = RigidTransform(self._setup.calibration.a_from_b.rotation, result.translation)
        return FusedFrames(result, a_from_b, pairs.time_ns)


@compiles(method.fuse_frames)
def compile_paper() -> None:
    """Compiles ``paper``; all bodies have its types."""
    _fuse_nobody("paper")


@compiles(method.fuse_frames_as_published)
def compile_published() -> None:
    """Compiles ``published``."""
    _fuse_nobody("published")


def _fuse_nobody(name: Method) -> None:
    setup = FusionSetup(nominal_calibration(KINECT_V2), FuserSettings(method=name))
    PaperFusion(setup).run(PairStacker(KINECT_V2).of_pair(SkeletonPair(None, None, 0)))
