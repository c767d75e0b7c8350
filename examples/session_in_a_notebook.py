# %% [markdown]
# # A session as arrays
# Jupyter (with Jupytext), VS Code and Spyder run the cells of this file. Make two sessions first:
# `duplex demo --seconds 10 --depth none --no-viewer --save demo.rrd`
# `duplex replay demo.rrd --method paper --no-viewer --save paper.rrd`

# %%
import matplotlib.pyplot as plt
import numpy as np

from recordings import Session

session, paper = Session.open("demo.rrd"), Session.open("paper.rrd")
print(session, f"the views differ by {np.nanmedian(session.quality.disagreement):.3f} m (median)")
seconds = session.time_ns * 1e-9
elbow, wrist = (session.body.joint(name) for name in ("ElbowRight", "WristRight"))
_, (bone, height, apart) = plt.subplots(3, sharex=True, layout="constrained")
# %% A bone: the right forearm, in each view and in S*
for name, joints in {"S_A": session.skeleton_a.positions, "S*": session.fused}.items():
    bone.plot(seconds, np.linalg.norm(joints[:, wrist] - joints[:, elbow], axis=1), label=name)
bone.set_ylabel("forearm (m)"), bone.legend()
# %% A joint with one standard deviation: y points down
up, sigma = -session.fused[:, wrist, 1], session.rows.sigma[:, wrist]
height.plot(seconds, up), height.fill_between(seconds, up - sigma, up + sigma, alpha=0.3)
height.set_ylabel("wrist (m)")
# %% Two methods: how far apart they put the wrist
apart.plot(seconds, np.linalg.norm(session.fused[:, wrist] - paper.fused[:, wrist], axis=1))
apart.set_ylabel("methods differ (m)"), apart.set_xlabel("s")
plt.savefig("wrist.png")
