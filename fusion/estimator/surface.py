"""Evidence and measurements of the joints from each sensor's depth image.

:mod:`fusion.witness` computes both from the numbers of each joint. This module assigns them to the
re-labelled joints and uses them in the frame.
"""

from __future__ import annotations

import math

from fusion.compiling.kernels import inner_kernel
from fusion.estimator.three import inverse
from fusion.facing.exchange import find_sources
from fusion.witness import weigh_witness


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


_TRACKED = 2  # fusion.skeleton.TrackingState.TRACKED
