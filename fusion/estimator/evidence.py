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
from fusion.solvers.small_matrices import inverse
from fusion.witness import weigh_witness

_TRACKED = 2  # fusion.skeleton.TrackingState.TRACKED


@inner_kernel
def ask_images(model, facing_model, views, a, states_a, witness_a, b, states_b, witness_b):  # type: ignore[no-untyped-def]
    """Evidence and surface measurement of each joint of both views, for the re-labelled joints.

    Args:
        model, facing_model: Of the body and the calibration.
        views: Re-labelled; evidence, places and their information are written.
        a, b: (J, 3) float32 metres, each in its sensor's frame.
        states_a, states_b: (J,) tracking states.
        witness_a, witness_b: (J, 4) float32 metres, see :mod:`fusion.witness`; NaN without an image.
    """
    said = views.said
    for v in range(2):
        if v == 0:
            weigh_witness(
                model.witness, model.rotations[0], model.translations[0], a, states_a, witness_a,
                said.evidence, said.places, said.information,
            )  # fmt: skip
        else:
            weigh_witness(
                model.witness, model.rotations[1], model.translations[1], b, states_b, witness_b,
                said.evidence, said.places, said.information,
            )  # fmt: skip
        find_sources(facing_model, views.reported[v], views.codes[v], said.sources)
        for i in range(len(model.parents)):
            # a joint that the exchange made inferred has no usable position
            source = said.sources[i]
            usable = views.states[v, i] == _TRACKED
            views.evidence[v, i] = said.evidence[source] if usable else 0.0
            for r in range(3):
                views.places[v, i, r] = said.places[source, r] if usable else math.nan
                for c in range(3):
                    views.place_information[v, i, r, c] = said.information[source, r, c]


@inner_kernel
def measure_surface(model, views, room):  # type: ignore[no-untyped-def]
    """Combines the surface's measurement p of information I with the tracker's z of slow covariance C.

        W = C⁻¹ + I',    z ← W⁻¹ (C⁻¹ z + I' p),    C ← W⁻¹,    I' = I / surface_slow²

    A surface jitters more than a tracker does: ``surface_fast`` is added to the fast error.

    Args:
        model, views: Of the pair.
        room: (3, 3) scratch.
    """
    k = model.constants
    noise, share = k.surface_fast**2, 1.0 / k.surface_slow**2
    for v in range(2):
        for i in range(len(model.parents)):
            if not math.isfinite(views.places[v, i, 0]) or views.states[v, i] == 0:
                continue
            says, C = views.place_information[v, i], views.slow[v, i]
            z, p = views.positions[v, i], views.places[v, i]
            inverse(C, room)
            x = y = w = 0.0
            for c in range(3):
                x += room[0, c] * z[c] + share * says[0, c] * p[c]
                y += room[1, c] * z[c] + share * says[1, c] * p[c]
                w += room[2, c] * z[c] + share * says[2, c] * p[c]
            for r in range(3):
                for c in range(3):
                    room[r, c] += share * says[r, c]
            inverse(room, C)
            for r in range(3):
                z[r] = C[r, 0] * x + C[r, 1] * y + C[r, 2] * w
            views.fast[v, i] += noise


@inner_kernel
def weigh_lengths(model, state, views):  # type: ignore[no-untyped-def]
    """Adds the evidence of the bones at each joint to that of the depth image.

        l_vi = - min(max_b |length of b in the view - l_b| / e_b, length_limit),
        e_b² = length_error² + (length_by_speed |u_end - u_parent|)²

    over the bones b at joint i whose ends the view tracks. The positions are those without the view's scale.
    It is a log likelihood ratio that the joint is no outlier: see :func:`robust.prior_outlier`. In a fast
    swing a tracker smears the limb, so a wrong length says less there.

    Args:
        model: Of the body and the calibration.
        state: The joints' velocities u are read.
        views: Positions and states are read; evidence and length errors are written.
    """
    k = model.constants
    still = k.length_error * k.length_error
    for v in range(2):
        at, errors = views.positions[v], views.length_errors[v]
        for i in range(len(model.parents)):
            errors[i] = -1.0
        for i in range(len(model.parents)):
            p = model.parents[i]
            if p < 0 or views.states[v, i] != _TRACKED or views.states[v, p] != _TRACKED:
                continue
            square = fast = 0.0
            for c in range(3):
                square += (at[i, c] - at[p, c]) ** 2
                fast += (state.velocities[i, c] - state.velocities[p, c]) ** 2
            expected = math.sqrt(still + k.length_by_speed * k.length_by_speed * fast)
            error = abs(math.sqrt(square) - model.bone_lengths[i]) / expected
            errors[i], errors[p] = max(errors[i], error), max(errors[p], error)
        for i in range(len(model.parents)):
            if errors[i] > 0.0:
                views.evidence[v, i] -= min(errors[i], k.length_limit)
