"""The coach's advice in the 3D scene: where to stand, which sensor has a problem, where B would see more."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from devices.findings.finding import Finding
from devices.findings.rules import RULES, TALL, WALK
from fusion.body import Body
from fusion.calibration.calibration import Calibration
from fusion.fused_frame import FusedFrame
from fusion.intrinsics import Intrinsics
from fusion.rigid import RigidTransform, rotation_of
from fusion.setup import FusionSetup
from recordings.appearance.coach_page import CoachPage, Mark, Point
from recordings.appearance.floor import CAMERA_HEIGHT, LEVEL_FLOOR, height_of
from recordings.appearance.state_card import State
from viewer_app.coach.readiness import Headline, to_markdown
from viewer_app.coach.setup_coach import HOLD, Situation
from viewer_app.coach.standing_spot import StandingSpot, standing_spot

_RING = 0.3  # metres, radius
_UNDER = 0.5  # metres
_COARSE = 0.1  # metres: rounding of the drawings, so that invisible changes are not logged
_FRUSTUM = 0.35  # metres: around the sensor's own
_BEST_ANGLE = 90.0  # degrees


class CoachScene:
    """Builds the coach's page."""

    def __init__(self, body: Body, cameras: tuple[Intrinsics, Intrinsics]) -> None:
        self._body, self._cameras = body, cameras

    def page(
        self,
        findings: Sequence[Finding],
        now: Situation,
        fused: FusedFrame | None = None,
        shown: Headline | None = None,
        notes: Sequence[str] = (),
        floor: RigidTransform | None = None,
    ) -> CoachPage:
        """The page to show now.

        Args:
            notes: What to know where nothing is wrong.
            shown: The headline of a set-up. The spot is drawn until it is ready, unless it says to walk.
                None: no spot is drawn.
            fused: The newest S*. None without a person.
            floor: K_A ← floor. None: level, at the usual height.
        """
        person = None if fused is None else self._person(fused)
        angle = any(each.rule == "angle" for each in findings)
        walks = shown is not None and shown.kind in RULES and RULES[shown.kind].live == WALK
        stands = shown is not None and shown.state is not State.READY and not walks
        marks = {
            "spot": self._spot(now, person, floor or LEVEL_FLOOR) if stands else None,
            "sensor_a": self._sensor("A", findings, RigidTransform.identity()),
            "sensor_b": self._sensor("B", findings, now.calibration.a_from_b),
            "better_b": self._better(now.calibration, floor or LEVEL_FLOOR) if angle else None,
        }
        drawn = tuple((name, mark) for name, mark in marks.items() if mark is not None)
        card = None if shown is None else (shown.state, shown.step)
        if shown is not None and shown.kind == "uncalibrated" and now.held > 0.0:
            card = shown.state, f"Hold still: {math.ceil(max(0.0, HOLD - now.held))} s"
        return CoachPage(to_markdown(findings, notes, shown), drawn, card)

    def _person(self, fused: FusedFrame) -> NDArray[np.float64] | None:
        """(2,) rounded x and z of the person's position."""
        torso = fused.positions[list(self._body.torso)]
        if not np.isfinite(torso).all():
            return None
        return _coarse(torso[:, [0, 2]].mean(axis=0))

    def _place(self, calibration: Calibration, floor: RigidTransform) -> StandingSpot:
        known = calibration.a_from_b if calibration.a_from_b.translation.any() else None
        return standing_spot(known, self._cameras, self._body.name, floor)

    def _spot(self, now: Situation, person: NDArray[np.float64] | None, floor: RigidTransform) -> Mark:
        place = self._place(now.calibration, floor)
        round_it = np.linspace(0.0, 2.0 * np.pi, 33)
        ring = place.x + _RING * np.cos(round_it), place.z + _RING * np.sin(round_it)
        # the words are below the ring and the point clouds, which would cover them
        post = _on(floor, np.array([place.x]), np.array([place.z])).repeat(2, axis=0)
        post[1, 1] += _UNDER
        lines, under = (_line(_on(floor, *ring)), _line(post)), _line(post)[1]
        to_go = np.zeros(2) if person is None else np.array([place.x, place.z]) - person
        far = float(np.linalg.norm(to_go))
        if person is None or now.held > 0.0 or place.is_at(*person):
            return Mark(lines, "do", under)
        along = to_go / far
        across = np.array([-along[1], along[0]])
        tip = person + along * (far - _RING)
        flat = [person, tip, tip - 0.15 * (along + 0.6 * across), tip, tip - 0.15 * (along - 0.6 * across)]
        return Mark((*lines, _line(_on(floor, *np.transpose(flat)))), "do", under)

    def _sensor(self, side: str, findings: Sequence[Finding], in_a: RigidTransform) -> Mark | None:
        if not any(each.side == side and RULES[each.rule].is_event for each in findings):
            return None
        return Mark(tuple(_frustum(self._cameras["AB".index(side)], in_a)), "mend")

    def _better(self, calibration: Calibration, floor: RigidTransform) -> Mark:
        """The position of B if it moved around the person until the axes form a right angle."""
        best = better_place(calibration.a_from_b, self._place(calibration, floor))
        way = np.linspace(calibration.a_from_b.translation, best.translation, 9)
        lines = (*_frustum(self._cameras[1], best), _line(way))
        under = _line(best.translation[None] + (0.0, _FRUSTUM, 0.0))[0]
        return Mark(lines, "better", under)


def better_place(a_from_b: RigidTransform, around: StandingSpot) -> RigidTransform:
    """K_B's pose in K_A's frame if it moved around a spot until the optical axes form a right angle."""
    angle = math.degrees(math.acos(float(np.clip(a_from_b.rotation[2, 2], -1.0, 1.0))))
    centre = np.array([around.x, 0.0, around.z])
    turned = []
    for sign in (-1.0, 1.0):
        turn = rotation_of([0.0, math.radians(sign * (_BEST_ANGLE - angle)), 0.0])
        turned.append(RigidTransform.of(turn, centre - turn @ centre) @ a_from_b)
    return min(turned, key=lambda each: abs(each.rotation[2, 2]))  # the cosine of the angle


def places(setup: FusionSetup) -> NDArray[np.float64]:
    """(N, 3) metres in K_A's frame: the sensors, a person on the spot, a better place for B, and all labels.

    Where B is unknown, it stands at a right angle to A.
    """
    body, a_from_b = setup.body, setup.calibration.a_from_b
    known = bool(a_from_b.translation.any())
    spot = standing_spot(a_from_b if known else None, setup.intrinsics, body.name, LEVEL_FLOOR)
    best = better_place(a_from_b, spot).translation
    sensors = [np.zeros(3), a_from_b.translation if known else best, best]
    person = [[spot.x, y, spot.z] for y in (CAMERA_HEIGHT + _UNDER, CAMERA_HEIGHT - TALL)]
    edges = [each + [0.0, y, 0.0] for each in sensors for y in (-_FRUSTUM, _FRUSTUM)]
    return np.array([*person, *edges])


def _frustum(camera: Intrinsics, in_a: RigidTransform) -> Iterator[tuple[Point, ...]]:
    """The image's edge, then the lines from it to the sensor."""
    x = _FRUSTUM * np.array([-camera.cx, camera.width - camera.cx]) / camera.fx
    y = _FRUSTUM * np.array([-camera.cy, camera.height - camera.cy]) / camera.fy
    corners = in_a.apply([[x[i], y[j], _FRUSTUM] for i, j in ((0, 0), (1, 0), (1, 1), (0, 1))])
    eye = in_a.translation
    yield _line(np.concatenate((corners, corners[:1])))
    for corner in corners:
        yield _line(np.stack((eye, corner)))


def _on(floor: RigidTransform, x: NDArray[np.float64], z: NDArray[np.float64]) -> NDArray[np.float64]:
    """(N, 3) points on the floor, in steps of a tenth of a metre in height."""
    return np.stack((x, _coarse(height_of(floor, x, z)), z), axis=-1)


def _line(points: NDArray[np.float64]) -> tuple[Point, ...]:
    return tuple((float(x), float(y), float(z)) for x, y, z in points)


def _coarse(values: NDArray[np.float64] | np.floating) -> NDArray[np.float64]:
    return np.asarray(np.round(np.asarray(values) / _COARSE) * _COARSE)
