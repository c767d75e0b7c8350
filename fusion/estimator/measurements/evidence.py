"""Evidence on the joints of each view besides the prediction: its depth image and its bone lengths.

:mod:`fusion.witness` computes the evidence and the surface measurement of a depth image. This module assigns
both to the re-labelled joints.

A limb that a tracker puts in the wrong place seldom keeps the lengths of its bones. A view shows this by
itself, without S* or the other view, and also where the other view sees nothing.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.facing.exchange import find_sources
from fusion.skeleton import TRACKED
from fusion.solvers.small_matrices import inverse
from fusion.witness import weigh_witness


@inner_kernel
def depth_evidence(model, facing_model, views, pairs, k):  # type: ignore[no-untyped-def]
    """Evidence and surface measurement of each re-labelled joint of both views of pair k."""
    image = views.image
    for v in range(2):
        if v == 0:
            positions, states, witness = pairs.a[k], pairs.states_a[k], pairs.witness_a[k]
        else:
            positions, states, witness = pairs.b[k], pairs.states_b[k], pairs.witness_b[k]
        image_seen = False
        for i in range(len(model.parents)):
            image_seen = image_seen or not math.isnan(witness[i, 0])
            views.log_odds[v, i], views.places[v, i, 0] = 0.0, math.nan
        if not image_seen:
            continue
        weigh_witness(
            model.witness, model.rotations[v], model.translations[v], positions, states, witness, image
        )
        find_sources(facing_model, views.reported[v], views.codes[v], views.sources)
        for i in range(len(model.parents)):
            # a joint that the exchange made inferred has no usable position
            source = views.sources[i]
            usable = views.states[v, i] == TRACKED
            views.log_odds[v, i] = image.log_odds[source] if usable else 0.0
            for r in range(3):
                views.places[v, i, r] = image.places[source, r] if usable else math.nan
                for c in range(3):
                    views.place_information[v, i, r, c] = image.information[source, r, c]


@inner_kernel
def measure_surface(model, views, solve):  # type: ignore[no-untyped-def]
    """Combines the surface's measurement p of information I with the tracker's z of slow covariance C.

        W = C⁻¹ + I',    z ← W⁻¹ (C⁻¹ z + I' p),    C ← W⁻¹,    I' = I / surface_slow²

    A surface jitters more than a tracker does: ``surface_fast`` is added to the fast error.
    """
    k, scratch = model.constants, solve.scratch
    noise, share = k.surface_fast**2, 1.0 / k.surface_slow**2
    for v in range(2):
        for i in range(len(model.parents)):
            if not math.isfinite(views.places[v, i, 0]) or views.states[v, i] == 0:
                continue
            information, C = views.place_information[v, i], views.slow[v, i]
            z, p = views.positions[v, i], views.places[v, i]
            inverse(C, scratch)
            x = y = w = 0.0
            for c in range(3):
                x += scratch[0, c] * z[c] + share * information[0, c] * p[c]
                y += scratch[1, c] * z[c] + share * information[1, c] * p[c]
                w += scratch[2, c] * z[c] + share * information[2, c] * p[c]
            for r in range(3):
                for c in range(3):
                    scratch[r, c] += share * information[r, c]
            inverse(scratch, C)
            for r in range(3):
                z[r] = C[r, 0] * x + C[r, 1] * y + C[r, 2] * w
            views.fast[v, i] += noise


@inner_kernel
def length_evidence(model, views):  # type: ignore[no-untyped-def]
    """Adds the evidence of the bones at each joint to that of the depth image.

        l_vi = - min(max_b |length of b in the view - l_b| / length_error, length_limit)

    over the bones b at joint i whose ends the view tracks. The positions are those without the view's scale.
    It is a log likelihood ratio that the joint is no outlier, see
    :func:`fusion.estimator.measurements.outliers.prior_outlier`.

    Args:
        views: Positions and states are read; evidence and length errors are written.
    """
    k = model.constants
    for v in range(2):
        x, errors = views.positions[v], views.length_errors[v]
        for i in range(len(model.parents)):
            errors[i] = -1.0
        for i in range(len(model.parents)):
            p = model.parents[i]
            if p < 0 or views.states[v, i] != TRACKED or views.states[v, p] != TRACKED:
                continue
            square = 0.0
            for c in range(3):
                square += (x[i, c] - x[p, c]) ** 2
            error = abs(math.sqrt(square) - model.bone_lengths[i]) / k.length_error
            errors[i], errors[p] = max(errors[i], error), max(errors[p], error)
        for i in range(len(model.parents)):
            if errors[i] > 0.0:
                views.log_odds[v, i] -= min(errors[i], k.length_limit)


@inner_kernel
def other_limb_evidence(model, views):  # type: ignore[no-untyped-def]
    """Adds the evidence that a view places a joint on the other limb: the mis-leading joint of sec. 3.

        l_vi = - min((|y_vi - y_wi|² - max(|y_vi - y_wm|², |y_vm - y_wm|²)) / (2 s²), other_limb_limit)
               + max(error_wi - length_limit, 0)

    where it is negative, with m the joint's counterpart on the other side and w the other view: view v has
    both joints where w has m, and w has i elsewhere. Hands that touch are together in both views, and are no
    such evidence. Nor is an arm of w whose bones have impossible lengths: error_wi is the largest error of
    those at i over the expected one (:func:`length_evidence`).
    """
    k = model.constants
    scale = 0.5 / (k.other_limb_sd * k.other_limb_sd)
    for i in range(len(model.parents)):
        m = model.mirror[i]
        seen = True
        for v in range(2):
            seen = seen and views.states[v, i] != 0 and views.states[v, m] != 0
        if not (model.limb[i] and seen):
            continue
        for v in range(2):
            mine, others = views.positions[v], views.positions[1 - v]
            there = max(_square(mine[i], others[m]), _square(mine[m], others[m]))
            evidence = min(scale * (_square(mine[i], others[i]) - there), k.other_limb_limit)
            evidence -= max(views.length_errors[1 - v, i] - k.length_limit, 0.0)
            if evidence > 0.0:
                views.log_odds[v, i] -= evidence


@inner_kernel
def _square(x, y):  # type: ignore[no-untyped-def]
    total = 0.0
    for c in range(3):
        total += (x[c] - y[c]) ** 2
    return total
