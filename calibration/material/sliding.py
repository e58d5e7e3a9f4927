# SPDX-License-Identifier: Apache-2.0
"""The coefficient of friction from records of a tool that slides over the gel.

Every stroke in one direction first sticks (the tangential force climbs with the travel) and then
slides; the break is found by fitting a climb and a plateau. The coefficient is the slope of the
tangential over the normal force while it slides, by a regression that outliers do not bend, with
an offset of the tangential force where strokes in both directions or a varying load tell it apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from taccel_lab.calibration.capture import ForceRecord
from taccel_lab.calibration.material.remarks import NEVER_SLID
from taccel_lab.calibration.material.robust_statistics import robust_regression
from taccel_lab.calibration.result import Estimate
from taccel_lab.errors import InputError
from taccel_lab.report.remark import Remark

MIN_STROKE = 8
"""Rows that a stroke needs."""
SLIDE_AFTER = 1.25
"""Sliding counts from this many break lengths on: the break is round, not sharp."""
STILL_CLIMBING = 0.1
"""A stroke whose tangential force still grows by this part over the slide has not slid fully."""
LOAD_RANGE = 0.2
"""Spread of the normal force, as a part of it, from which it tells slope and offset apart."""
MAX_FRICTION = 5.0


@dataclass(frozen=True)
class Stroke:
    """Travel in one direction."""

    direction: int
    """1 along +shift, -1 against."""
    travel_mm: np.ndarray
    """From the start of the stroke, rising, shape [row]."""
    normal_n: np.ndarray
    tangential_n: np.ndarray
    break_mm: float
    """Travel at which the tool begins to slide."""
    climbing: bool
    """Whether the tangential force never settles."""

    @property
    def slides(self) -> np.ndarray:
        """Rows in which the tool slides, bool."""
        if self.climbing:
            return np.zeros(len(self.travel_mm), dtype=bool)
        return self.travel_mm >= SLIDE_AFTER * self.break_mm


@dataclass(frozen=True)
class SlideFit:
    """Friction of one record."""

    name: str
    source: str
    sha256: str
    friction: Estimate
    """Mean coefficient while sliding; of a record that never slides the least that it can be."""
    offset_n: float
    """Tangential force at no load."""
    slid: bool
    normal_range_n: tuple[float, float]
    strokes: tuple[Stroke, ...]
    relative_residual: float
    """Root mean square of tangential force less fit while sliding, as a part of the force."""
    remarks: tuple[Remark, ...]
    sign: int = 1
    """1: positive tangential force along the motion; -1: against it."""

    def residuals(self) -> dict[str, float]:
        """Of a tool that slid."""
        return {"slide_rms_relative": self.relative_residual} if self.slid else {}

    def valid_region(self) -> dict[str, tuple[float, float]]:
        """Normal forces."""
        return {"slide_normal_n": self.normal_range_n}

    def figures(self) -> dict[str, Any]:
        """What was found, ready for JSON."""
        return {
            "name": self.name,
            "friction": self.friction.value,
            "sigma": self.friction.sigma,
            "slid": self.slid,
            "offset_n": self.offset_n,
        }

    def predicted_n(self, stroke: Stroke) -> np.ndarray:
        """Tangential force of the fit in the rows of a stroke [N], in the record's signs."""
        sign = stroke.direction * self.sign
        return sign * self.friction.value * stroke.normal_n + self.offset_n


def fit_slide(record: ForceRecord) -> SlideFit:
    """Friction of a slide record, columns shift_mm, normal_n and tangential_n.

    Raises:
        InputError: No motion, no load, loads of both signs, or too few rows.
    """
    shift, normal, tangential = (
        record.columns[key] for key in ("shift_mm", "normal_n", "tangential_n")
    )
    name = record.name
    _check(record.source, shift, normal)
    strokes = _strokes(shift, normal, tangential)
    if not strokes:
        raise InputError(
            f"{record.source}: no stroke of at least {MIN_STROKE} rows in one direction; shift_mm "
            f"spans {np.ptp(shift):g} mm in {len(shift)} rows"
        )
    sliding = [stroke for stroke in strokes if stroke.slides.sum() >= MIN_STROKE // 2]
    load = (float(normal.min()), float(normal.max()))
    if not sliding:
        return _never_slid(record, name, strokes, load)
    return _slid(record, name, strokes, sliding, load)


def _check(source: str, shift: np.ndarray, normal: np.ndarray) -> None:
    if np.ptp(shift) <= 0:
        raise InputError(f"{source}: shift_mm does not change; the tool has to move sideways")
    low, high = float(normal.min()), float(normal.max())
    if low <= 0.02 * high:
        raise InputError(
            f"{source}: normal_n falls to {low:.3g} N (at most {high:.3g} N); the tool has to stay "
            "in contact: cut the rows in which it is lifted"
        )


def _strokes(shift: np.ndarray, normal: np.ndarray, tangential: np.ndarray) -> list[Stroke]:
    """Runs in one direction; rests and turns of less than a fiftieth of the way are bridged."""
    slack = 0.02 * float(np.ptp(shift))
    turns, direction, extreme = [0], 0, 0
    for i in range(1, len(shift)):
        step = shift[i] - shift[extreme]
        if direction == 0 and abs(step) > slack:
            direction = 1 if step > 0 else -1
            extreme = i
        elif direction * step > 0:
            extreme = i
        elif direction and -direction * step > slack:
            turns.append(extreme)
            direction, extreme = -direction, i
    turns.append(len(shift) - 1)
    strokes = []
    for a, b in pairwise(turns):
        stroke_mm = float(shift[b] - shift[a])
        if b - a + 1 < MIN_STROKE or stroke_mm == 0:
            continue
        rows = slice(a, b + 1)
        sign = 1 if stroke_mm > 0 else -1
        travel = np.maximum.accumulate(sign * (shift[rows] - shift[a]))
        ratio = tangential[rows] / normal[rows]
        length, climbing = _break(travel, ratio)
        strokes.append(Stroke(sign, travel, normal[rows], tangential[rows], length, climbing))
    return strokes


def _break(travel: np.ndarray, ratio: np.ndarray) -> tuple[float, bool]:
    """Travel at which a climb becomes a plateau, and whether there is no plateau."""
    end = float(travel[-1])
    best, found = math.inf, 0.0
    for length in np.linspace(0.0, 1.0, 41) * end:
        climb = np.minimum(travel, length) if length > 0 else np.zeros_like(travel)
        columns = np.stack([np.ones_like(travel), climb], axis=1)[:, : 2 if length > 0 else 1]
        weight = np.ones(len(travel))
        for _ in range(4):  # least absolute deviations by reweighting
            fit = np.linalg.lstsq(columns * weight[:, None], ratio * weight, rcond=None)[0]
            deviation = np.abs(ratio - columns @ fit)
            weight = np.sqrt(1 / np.maximum(deviation, 1e-4 * np.ptp(ratio) + 1e-12))
        if deviation.sum() < (1 - 1e-3) * best:
            best, found = float(deviation.sum()), float(length)
    if found > 0.8 * end:
        return found, True
    after = travel >= min(SLIDE_AFTER * found, end)
    if after.sum() < MIN_STROKE // 2:
        return found, True
    trend = np.polyfit(travel[after], ratio[after], 1)
    growth = trend[0] * np.ptp(travel[after])
    level = float(np.median(ratio[after]))
    noise = float(np.std(ratio[after] - np.polyval(trend, travel[after])))
    sure = abs(growth) > 4 * noise / math.sqrt(after.sum()) * math.sqrt(12)
    return found, bool(sure and growth * np.sign(level) > STILL_CLIMBING * abs(level))


def _never_slid(
    record: ForceRecord, name: str, strokes: Sequence[Stroke], load: tuple[float, float]
) -> SlideFit:
    least = max(
        float(np.percentile(np.abs(stroke.tangential_n / stroke.normal_n), 95))
        for stroke in strokes
    )
    remark = NEVER_SLID(name=name, least=least)
    return SlideFit(
        name, record.source, record.sha256, Estimate(least, math.inf), 0.0, False, load,
        tuple(strokes), math.nan, (remark,),
    )  # fmt: skip


def _slid(
    record: ForceRecord,
    name: str,
    strokes: Sequence[Stroke],
    sliding: Sequence[Stroke],
    load: tuple[float, float],
) -> SlideFit:
    direction = np.concatenate([np.full(s.slides.sum(), s.direction) for s in sliding])
    normal = np.concatenate([s.normal_n[s.slides] for s in sliding])
    tangential = np.concatenate([s.tangential_n[s.slides] for s in sliding])
    both = len(set(direction.tolist())) == 2
    two_unknowns = both or np.ptp(normal) > LOAD_RANGE * normal.mean()
    columns = (direction * normal)[:, None]
    if two_unknowns:
        columns = np.column_stack([columns, np.ones(len(normal))])
    fit = robust_regression(columns, tangential)
    slope, offset = float(fit.values[0]), float(fit.values[1]) if two_unknowns else 0.0
    sign = 1 if slope >= 0 else -1
    value = abs(slope)
    if value > MAX_FRICTION:
        raise InputError(
            f"{record.source}: tangential over normal force is {value:.3g} while the tool slides; "
            f"at most {MAX_FRICTION:g} is a coefficient of friction. Are both forces in newtons, "
            "and not swapped?"
        )
    if value < 0.01:
        raise InputError(
            f"{record.source}: tangential over normal force is only {value:.2g} while the tool "
            "slides; no gel is that slippery. Are both forces in newtons, and not swapped?"
        )
    level = float(np.abs(tangential - offset).mean())
    return SlideFit(
        name,
        record.source,
        record.sha256,
        fit.estimate(value, np.eye(columns.shape[1])[0]),
        offset,
        True,
        load,
        tuple(strokes),
        float(np.sqrt(np.mean(fit.residuals**2))) / level,
        (),
        sign,
    )
