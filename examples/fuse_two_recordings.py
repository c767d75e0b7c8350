"""Fuses two recordings: python fuse_two_recordings.py a.csv b.csv walk.rrd

The recordings are .csv files as the README describes them, or .json, .skeleton and .mkv files.
"""

import sys

import numpy as np

from recordings import fuse

a, b, saved = sys.argv[1:4]
session = fuse(a, b)  # in memory: nothing is written

print(f"{len(session)} frames of {len(session.body)} joints, {session.calibration.how}")
print("S* has the shape", session.fused.shape, "in metres, in the frame of sensor A")
print(f"The views differ by {np.nanmedian(session.quality.disagreement) * 1e3:.0f} mm (median).")

session.save(saved)  # what `duplex fuse --save` writes
