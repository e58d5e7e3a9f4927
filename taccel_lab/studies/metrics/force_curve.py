# SPDX-License-Identifier: Apache-2.0
"""What engineers read off a curve of force over depth: stiffness, exponent, saturation, depth.

Half-spaces have F = a d^1.5 under a ball (Hertz) and F = a d under a flat punch or a roller. Gels
bonded to a plate begin near that and grow stiffer, the thinner the earlier.
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import NoFigure, metric
from taccel_lab.studies.metrics.design_point import Fitted
from taccel_lab.studies.metrics.evidence import Evidence, at_load, contact_radius_mm
from taccel_lab.studies.presses.press_record import PressRecord

LEFT = 1.5
"""Force over that of the first third of the press gone on by its power law, from which a curve
counts as saturated."""
_DOWN = ("punch", "cylinder")
_LAWS = {"sphere": 1.5, "cylinder": 1.0, "roller": 1.0}


def _law(record: PressRecord) -> float:
    """Exponent of a half-space under the tool."""
    kind = record.indenter.partition(":")[0]
    if kind not in _LAWS:
        raise NoFigure(f"{record.indenter} has no power law")
    return _LAWS[kind]


def _curve(evidence: Evidence) -> tuple[PressRecord, np.ndarray, np.ndarray]:
    record = evidence.one(evidence.press)
    depth, force = record.depth_mm[record.down], record.normal_n
    if len(depth) < 3 or not (force > 0).all():
        raise NoFigure(f"press {record.press} has {len(depth)} steps; three are needed for a curve")
    return record, depth, force


@metric(
    "stiffness_a", "N/mm^1.5",
    "a of F = a d^1.5 under {tool}, least squares over all steps of the press", "none",
    ("sphere",),
)  # fmt: skip
def stiffness_a(evidence: Evidence) -> Fitted:
    """Plain least squares of the force; the interval is that of Student's t over the residuals,
    which are what the gel is stiffer than the law at depth."""
    from scipy.stats import t

    _, depth, force = _curve(evidence)
    basis = depth**1.5
    a = float(basis @ force / (basis @ basis))
    rest = force - a * basis
    dof = len(depth) - 1
    sigma = math.sqrt(float(rest @ rest) / dof / float(basis @ basis))
    return Fitted(a, float(t.ppf(0.975, dof)) * sigma)


@metric(
    "force_exponent", "1",
    "p of F = c d^p under {tool} over all steps of the press: 1.5 of a ball on a thick gel, more "
    "on a thin one", "none", ("sphere",), also=_DOWN,
)  # fmt: skip
def force_exponent(evidence: Evidence) -> Fitted:
    """Least squares in logarithms."""
    from scipy.stats import t

    _, depth, force = _curve(evidence)
    x, y = np.log(depth), np.log(force)
    slope, level = np.polyfit(x, y, 1)
    rest = y - slope * x - level
    dof = len(depth) - 2
    sigma = math.sqrt(float(rest @ rest) / dof / float(np.square(x - x.mean()).sum()))
    return Fitted(float(slope), float(t.ppf(0.975, dof)) * sigma)


def _saturation(evidence: Evidence) -> tuple[float, float]:
    """Depth [mm] and force [N] at which the curve has left the law of its first third."""
    record, depth, force = _curve(evidence)
    power = _law(record)
    first = max(int(np.searchsorted(depth, depth[-1] / 3 * (1 + 1e-9), side="right")), 1)
    basis = depth[:first] ** power
    a = float(basis @ force[:first] / (basis @ basis))
    ratio = np.log(force / (a * depth**power))
    beyond = np.flatnonzero(ratio >= math.log(LEFT))
    if not len(beyond) or beyond[0] == 0:
        raise NoFigure(
            f"press {record.press} ends at {depth[-1]:.3g} mm, where the force is "
            f"{math.exp(ratio[-1]):.3g} times that of the law of its first third; {LEFT:g} times "
            "is saturation"
        )
    k = int(beyond[0])
    x, y = np.log(depth), np.log(force)
    part = (math.log(LEFT) - ratio[k - 1]) / (ratio[k] - ratio[k - 1])
    at = x[k - 1] + part * (x[k] - x[k - 1])
    return math.exp(at), math.exp(np.interp(at, x, y))


@metric(
    "saturation_depth", "mm",
    "depth at which {tool} feels 1.5 times the force that the law of the press's first third "
    "(F = a d^1.5; F = a d of flat punches and rollers) has there", "higher", ("sphere",),
    also=_DOWN,
)  # fmt: skip
def saturation_depth(evidence: Evidence) -> float:
    """By power laws between the steps."""
    return _saturation(evidence)[0]


@metric(
    "saturation_force", "N", "force of {tool} at saturation_depth", "higher", ("sphere",),
    also=_DOWN,
)  # fmt: skip
def saturation_force(evidence: Evidence) -> float:
    """By power laws between the steps."""
    return _saturation(evidence)[1]


@metric(
    "depth_at_load", "mm", "depth of {tool} past first touch at {load}", "none", ("sphere",),
    also=_DOWN,
)  # fmt: skip
def depth_at_load(evidence: Evidence) -> float:
    """By power laws between the steps."""
    record = evidence.one(evidence.press)
    return at_load(record, record.depth_mm[record.down], evidence.load_n)


@metric(
    "contact_diameter", "mm", "diameter of the disc of the contact's area of {tool} at {load}",
    "none", ("sphere",), also=_DOWN,
)  # fmt: skip
def contact_diameter(evidence: Evidence) -> float:
    """By power laws between the steps."""
    record = evidence.one(evidence.press)
    return at_load(record, 2 * contact_radius_mm(record), evidence.load_n)
