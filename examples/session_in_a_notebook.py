# %% [markdown]
# # A session as arrays
# Jupyter (with Jupytext), VS Code and Spyder run the cells of this file. Make a session first:
# `duplex demo --seconds 10 --depth none --no-viewer --save demo.rrd`

# %%
import matplotlib.pyplot as plt
import numpy as np

from recordings import Session

session = Session.open("demo.rrd")
print(session, session.body.joints[:4], [event.text for event in session.events][:2])

# %% The height of the right wrist: y points down
wrist = session.body.joint("WristRight")
seconds = session.time_ns * 1e-9
views = {"S_A": session.skeleton_a.positions, "S*": session.fused}
for name, positions in views.items():
    plt.plot(seconds, -positions[:, wrist, 1], label=name)
plt.xlabel("s"), plt.ylabel("m"), plt.legend()

# %% How far the two views are apart, and how well S* keeps its bones
print(f"the views differ by {np.nanmedian(session.quality.disagreement) * 1e3:.0f} mm (median)")
print(f"largest bone error of S*: {np.nanmax(session.quality.bone_error) * 1e3:.2g} mm")
plt.savefig("wrist.png")
