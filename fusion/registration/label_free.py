"""A registration that does not depend on which side of the body a tracker calls left."""

from __future__ import annotations

import numpy as np

from fusion.body import Body
from fusion.errors import CalibrationError
from fusion.registration.keyframes import Evidence
from fusion.registration.rigid_fit import fit_rigid
from fusion.rigid import RigidTransform


def label_free_fit(body: Body, evidence: Evidence) -> RigidTransform | None:
    """A robust fit of R and t to the midline and to midpoints of left and right; None if undetermined.

    These points are the same whether or not a view is mirrored. They determine R only if the person walks
    about.
    """
    own = np.array([j for j in range(len(body)) if j <= body.mirror[j]])
    other = body.mirror[own]
    usable = np.minimum(evidence.weights[:, own], evidence.weights[:, other]) > 0.5
    p = (0.5 * (evidence.a[:, own] + evidence.a[:, other]))[usable]
    q = (0.5 * (evidence.b[:, own] + evidence.b[:, other]))[usable]
    try:
        found = fit_rigid(p, q)
        for _ in range(10):
            apart = np.linalg.norm(p - found.apply(q), axis=1)
            near = apart <= 2.0 * max(float(np.median(apart)), 1e-4)
            found = fit_rigid(p[near], q[near])
    except CalibrationError:
        return None
    return found
