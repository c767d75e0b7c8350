"""What the numbers of a file of skeletons mean: unit and axes, stated or found by their likelihood.

One mechanism decides each question: the options are scored by :mod:`.likelihood`, a clear winner is taken,
two that fit alike are refused with both, and if none fits the best ones are named. Two files are judged
together, because they show one person, and mostly come from one program.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from devices.sensor import DeviceError
from devices.skeletons.likelihood import place_likelihood, size_likelihood
from devices.skeletons.stated_format import (
    METRES,
    OWN_AXES,
    SIGNED,
    StatedFormat,
    Unit,
    axes_in_words,
    called_axes,
    index_of,
    matrix_of,
)
from fusion.support.types import Array

_PRIOR = MappingProxyType(
    {OWN_AXES: 1.0, "kinect": 0.8, "unity": 0.5, "opengl": 0.5, "ros": 0.5, "-y,x,z": -1.0, "y,-x,z": -1.0}
)
_OTHER = -1.0, -1.5  # log priors of a second file in other axes than the first, at most; and of two programs
_OWN_UNIT = 2.0
_POSTURE = 0.25  # deviation of the direction of gravity in one body, by two files
_ONE_PERSON = 0.2  # deviation of the logarithm of one person's size in two files
CLEAR = 2.5
"""How much more likely, as a logarithm, an option is than the next one to be taken."""
_NONE = -9.0
"""The log likelihood below which no option fits."""
_WITHIN = 0.2  # statures from the origin: no sensor sees a person from inside


Likelihoods = Mapping[str, Sequence[tuple[str, float]]]
"""The options of each question, the best first, and their log likelihoods below it."""


class MeaningError(DeviceError):
    """No meaning of a file is clear. ``table`` has its options, as :class:`Meaning`."""

    def __init__(self, message: str, table: Likelihoods) -> None:
        super().__init__(message)
        self.table = table


@dataclass(frozen=True, eq=False)
class Evidence:
    """What a file tells of its meaning.

    Attributes:
        name: Of the file, for messages.
        stated: What is stated.
        unit: Unit that the format defines.
        free: Whether the format leaves the axes open.
        stature: Of the person, in the file's unit; None if too few bones were seen.
        away: How far the person is from the origin, in the file's unit.
        axes: (2, 48) log likelihoods of the axes, if the person stands and if it lies.
        down: (48, 3) the direction of gravity in the body's frame by these axes; the same in both views.
        relative: Whether a coordinate of the hips is 0 in all frames.
    """

    name: object
    stated: StatedFormat
    unit: Unit
    free: bool
    stature: float | None
    away: float
    axes: Array
    down: Array
    relative: bool = False


@dataclass(frozen=True, eq=False)
class Meaning:
    """How a file is read.

    Attributes:
        unit: A key of :data:`METRES`.
        axes: One of :data:`.likelihood.SIGNED`.
        table: The best options and their log likelihoods below the best, for each question.
        told: What is odd about what is stated, a line each.
    """

    unit: str
    axes: str
    table: Likelihoods
    told: tuple[str, ...] = ()

    @property
    def metres(self) -> float:
        """Metres per unit."""
        return METRES[self.unit][0]

    @property
    def in_words(self) -> str:
        """The axes as a user states them, and what they are."""
        return axes_in_words(self.axes)

    def turned(self, xyz: Array) -> Array:
        """Positions (..., 3) of the file in the sensor's axes, and in its unit."""
        axes = matrix_of(self.axes)
        return xyz if self.axes == OWN_AXES else xyz[..., np.abs(axes).argmax(axis=1)] * axes.sum(axis=1)


def decide(of: Sequence[Evidence]) -> list[Meaning]:
    """The meaning of one file, or of the two files of one capture.

    Raises:
        DeviceError: Two options fit alike, or none does; or what is stated cannot be.
    """
    sizes = [np.log([(each.stature or np.nan) * metres for metres, _ in METRES.values()]) for each in of]
    apart = np.nan_to_num(sizes[0][:, None] - sizes[-1][None])
    one_person = np.maximum(-0.5 * (apart / _ONE_PERSON) ** 2, _NONE)
    own = PRIOR_OF_AXES - PRIOR_OF_AXES.max()
    one_program = np.tile(np.maximum(own, _OTHER[0]) - own + _OTHER[1], (len(own), 1))
    np.fill_diagonal(one_program, -own)
    units = _together([_unit_scores(each) for each in of], one_person)
    one_posture = of[0].down[:, None] - of[-1].down[None]
    axes = _together(
        [each.axes + PRIOR_OF_AXES for each in of],
        one_program - 0.5 * np.sum((one_posture / _POSTURE) ** 2, axis=2),
    )
    return [_meaning(each, *scores) for each, *scores in zip(of, units, axes, strict=True)]


PRIOR_OF_AXES = np.array([_PRIOR.get(called_axes(axes), 0.0) for axes in SIGNED])
"""(48,) log prior of the axes: of programs, and of a sensor on its side."""


def _unit_scores(of: Evidence) -> Array:
    """(1, 5) log likelihood of each unit."""
    scores = [_OWN_UNIT * (unit == of.unit) for unit in METRES]
    if of.stature:
        for k, (metres, _) in enumerate(METRES.values()):
            scores[k] += size_likelihood(of.stature * metres) + place_likelihood(of.away * metres)
    return np.array([scores])


def _together(scores: Sequence[Array], prior: Array) -> list[Array]:
    """The log likelihoods of each file's options, with the best option of the other file.

    Args:
        scores: (Z, N) of each file; that the person lies, if Z is 2, holds for both.
        prior: (N, N) of the options of both.
    """
    if len(scores) < 2:
        return [np.logaddexp.reduce(scores[0], axis=0)]
    both = np.logaddexp.reduce(scores[0][:, :, None] + scores[1][:, None], axis=0) + prior
    return [both.max(axis=1), both.max(axis=0)]


def _meaning(of: Evidence, units: Array, axes: Array) -> Meaning:
    by_unit, by_axes = _ranked(list(METRES), units), _ranked(SIGNED, axes)
    table = {"unit": by_unit, "axes": [(called_axes(one), score) for one, score in by_axes]}
    try:
        if of.stature and (of.relative or of.away < _WITHIN * of.stature):
            raise DeviceError(
                f"{of.name}: the positions are relative to the person, whose middle is at 0 in all frames, as"
                " MediaPipe's world landmarks are. Fusion needs positions in the sensor's frame, as a depth "
                "image gives them."
            )
        unit, told = _unit(of, by_unit)
        wanted = of.stated.signed_axes or ("" if of.free else OWN_AXES)
        if of.stature is None and np.ptp(of.axes) < CLEAR:  # nobody is seen
            return Meaning(unit, wanted or OWN_AXES, table, told)
        if wanted:
            return Meaning(unit, wanted, table, (*told, *_tested(of, wanted, by_axes)))
        return Meaning(unit, _axes(of, by_axes), table, told)
    except DeviceError as error:
        raise MeaningError(str(error), table) from None


def _ranked(options: Sequence[str], scores: Array) -> list[tuple[str, float]]:
    order = np.argsort(-scores, kind="stable")
    return [(options[k], float(scores[k] - scores[order[0]])) for k in order]


def _unit(of: Evidence, table: Sequence[tuple[str, float]]) -> tuple[str, tuple[str, ...]]:
    """The unit, and a line where the stated one is unlikely."""
    (best, _), (other, behind) = table[:2]
    wanted = of.stated.unit
    if of.stature is None:
        return of.unit if wanted == "auto" else wanted, ()
    person = {
        unit: f"{of.stature * metres:.3g} m tall and {of.away * metres:.3g} m away in {words}"
        for unit, (metres, words) in METRES.items()
    }
    if wanted != "auto":
        fits = dict(table)[wanted] > _NONE
        option = of.stated.option("unit", wanted)
        return wanted, () if fits else (
            f"{of.name}: by {option} the person is {person[wanted]}; {best} fits better.",
        )
    if _unit_scores(of).max() < 2.0 * _NONE or behind > -CLEAR:
        raise DeviceError(
            f"{of.name}: the unit of the positions is unclear; the person would be {person[best]}, or "
            f"{person[other]}. State it with {of.stated.option('unit')} (m, cm, mm, ft or in)."
        )
    return best, ()


def _axes(of: Evidence, table: Sequence[tuple[str, float]]) -> str:
    alike = [one for one, behind in table if behind > -CLEAR]
    best = alike[0]
    options = " or ".join(of.stated.option("axes", called_axes(one)) for one in alike)
    if (np.logaddexp.reduce(of.axes, axis=0) + PRIOR_OF_AXES).max() < _NONE:
        raise DeviceError(f"{of.name}: in no axes is this a person before a sensor; {options} fits best.")
    if len(alike) > len(SIGNED) / 2:
        raise DeviceError(f"{of.name}: its joints do not tell the axes. State {of.stated.option('axes')}.")
    if len(alike) > 1:
        every = "; ".join(map(axes_in_words, alike))
        raise DeviceError(f"{of.name}: {len(alike)} axes fit alike: {every}. State {options}.")
    return best


def _tested(of: Evidence, wanted: str, table: Sequence[tuple[str, float]]) -> tuple[str, ...]:
    """A line where stated axes are doubtful.

    Raises:
        DeviceError: By them the person is a mirror image, or not before the sensor.
    """
    scores, best = dict(table), table[0][0]
    option = of.stated.option("axes", of.stated.axes) if of.stated.axes else of.stated.option("orientation")
    option = option if of.free and not of.stated.of_images else "its format"
    mine, right = matrix_of(wanted), matrix_of(best)
    fitting = of.stated.option("axes", called_axes(best))
    more_than_mirrored = scores[wanted] - scores[SIGNED[index_of(mine * [[-1.0], [1.0], [1.0]])]]
    if more_than_mirrored < -CLEAR:
        raise DeviceError(
            f"{of.name}: by {option} the person is a mirror image, so the result is left-handed. Change the "
            f"sign of one axis; {fitting} fits."
        )
    if more_than_mirrored < CLEAR and of.stated.axes:
        return (
            f"{of.name}: whether the person is a mirror image by {option} is unknown, because it has no feet "
            "and no face. Raise the left arm, and see whether S* does.",
        )
    if scores[wanted] >= -CLEAR or of.stated.of_images:
        return ()
    if (mine[2] == right[2]).all():
        return (f"{of.name}: by {option} the person is not upright; {fitting} fits better.",)
    raise DeviceError(
        f"{of.name}: by {option} the person is not before the sensor: the z axis must point forward, towards "
        f"the person. {fitting} fits."
    )


def said(of: Evidence, meaning: Meaning, names: str, clock: str) -> list[str]:
    """The line about a file that is not as this program defines it, for what is not stated.

    Args:
        names, clock: How its names and its times are read, if otherwise.
    """
    parts = [names] if names else []
    if meaning.axes != OWN_AXES and not of.stated.signed_axes:
        parts.append(axes_in_words(meaning.axes))
    if meaning.unit != of.unit and of.stated.unit == "auto" and of.stature is not None:
        tall = of.stature * meaning.metres
        parts.append(f"{METRES[meaning.unit][1]}, so that the person is {tall:.2f} m tall")
    options = ", ".join(of.stated.option(name) for name in ("names", "axes", "unit")) if parts else ""
    parts += [clock] if clock else []
    way = f" State otherwise with {options}." if options else ""
    return [f"{of.name}: read as {'; '.join(parts)}.{way}"] if parts else []
