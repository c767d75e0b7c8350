"""What the server of the programs imports and compiles once; processes are forked from it."""

import viewer_app.commands.live  # noqa: F401
from fusion.body import AZURE_KINECT
from fusion.calibration.calibration import nominal_calibration
from fusion.fuser import Fuser
from fusion.setup import FusionSetup
from tests.scenarios import program  # noqa: F401

Fuser(FusionSetup(nominal_calibration(AZURE_KINECT))).warm_up()
