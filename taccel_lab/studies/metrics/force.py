# SPDX-License-Identifier: Apache-2.0
"""What engineers read off a curve of force over depth, and the modulus and stress behind it.

Half-spaces have F = a d^1.5 under a ball (Hertz) and F = a d under a flat punch or a roller. Gels
bonded to a plate begin near that and grow stiffer, the thinner the earlier.
"""

from __future__ import annotations

import math

import numpy as np

from taccel_lab.studies.metrics.base import metric
from taccel_lab.studies.metrics.design_point import Fitted, NoFigure
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
    """Interpolates by power laws between the steps."""
    return _saturation(evidence)[0]


@metric(
    "saturation_force", "N", "force of {tool} at saturation_depth", "higher", ("sphere",),
    also=_DOWN,
)  # fmt: skip
def saturation_force(evidence: Evidence) -> float:
    """Interpolates by power laws between the steps."""
    return _saturation(evidence)[1]


@metric(
    "depth_at_load", "mm", "depth of {tool} past first touch at {load}", "none", ("sphere",),
    also=_DOWN,
)  # fmt: skip
def depth_at_load(evidence: Evidence) -> float:
    """Interpolates by power laws between the steps."""
    record = evidence.one(evidence.press)
    return at_load(record, record.depth_mm[record.down], evidence.load_n)


@metric(
    "contact_diameter", "mm", "diameter of the disc of the contact's area of {tool} at {load}",
    "none", ("sphere",), also=_DOWN,
)  # fmt: skip
def contact_diameter(evidence: Evidence) -> float:
    """Interpolates by power laws between the steps."""
    record = evidence.one(evidence.press)
    return at_load(record, 2 * contact_radius_mm(record), evidence.load_n)


BOTTOM_STRAIN = 0.4
"""Depth over thickness at which a gel counts as bottomed out. How much stiffer it has become than a
half-space says nothing of that: thin gels are three times as stiff from the first contact on."""
MOST_AHEAD = 1.5
"""How far beyond its deepest step a press may be continued."""


@metric(
    "force_range", "N",
    "force of {tool} before bottoming, at a depth of 40 % of the gel's thickness",
    "higher", ("sphere",), smooth=True,
)  # fmt: skip
def force_range(evidence: Evidence) -> float:
    """Interpolates by power laws between the steps.

    Where a thick gel was not pressed quite as deep, that of the last two steps goes on.
    """
    record = evidence.one("sphere")
    depth, force = record.depth_mm[record.down], record.normal_n
    if len(force) < 2:
        raise NoFigure("press sphere has one step alone; two are needed")
    limit = BOTTOM_STRAIN * record.thickness_mm
    if limit > MOST_AHEAD * depth[-1]:
        raise NoFigure(f"the gel bottoms at {limit:.3g} mm, and press sphere ends at "
                          f"{depth[-1]:.3g} mm")  # fmt: skip
    if limit > depth[-1]:
        power = math.log(force[-1] / force[-2]) / math.log(depth[-1] / depth[-2])
        return float(force[-1] * (limit / depth[-1]) ** power)
    return float(np.exp(np.interp(math.log(limit), np.log(depth), np.log(force))))


@metric(
    "stiffness_punch", "N/mm",
    "initial slope of force over depth under {tool}", "none", ("punch",),
)  # fmt: skip
def stiffness_punch(evidence: Evidence) -> float:
    """F / d at zero depth, of a line through the steps' F / d.

    A free parabola of F takes five times as much from the noise of a mesh: of forces 3 % off it
    makes a slope 23 % off. Depths count from the touch, so that it has no offset to find.
    """
    record = evidence.one("punch")
    depth, force = record.depth_mm[record.down], record.normal_n
    if len(depth) < 3:
        raise NoFigure(f"press punch has {len(depth)} steps; three are needed for a slope")
    return float(np.polynomial.Polynomial.fit(depth, force / depth, 1).convert().coef[0])


@metric(
    "stiffness_secant", "N/mm", "load over depth of {tool} at {load}", "none",
    ("sphere",), smooth=True,
)  # fmt: skip
def stiffness_secant(evidence: Evidence) -> float:
    """F / d at the load."""
    record = evidence.one("sphere")
    depth = at_load(record, record.depth_mm[record.down], evidence.load_n)
    return evidence.load_n / depth


@metric(
    "stiffness_tangent", "N/mm", "slope of force over depth of {tool} at {load}",
    "none", ("sphere",),
)  # fmt: skip
def stiffness_tangent(evidence: Evidence) -> float:
    """dF/dd = (F / d) p with F ~ d^p around the load."""
    record = evidence.one("sphere")
    depth = record.depth_mm[record.down]
    a, b = (at_load(record, depth, load * evidence.load_n) for load in (0.99, 1.0))
    return 0.01 * evidence.load_n / (b - a)


@metric(
    "stiffness_roller", "N/mm",
    "load over depth of {tool} at {load}", "none", ("cylinder",),
)  # fmt: skip
def stiffness_roller(evidence: Evidence) -> float:
    """F / d of a line contact at the load."""
    record = evidence.one("cylinder")
    depth = at_load(record, record.depth_mm[record.down], evidence.load_n)
    return evidence.load_n / depth


@metric(
    "bond_stress", "kPa",
    "largest von Mises stress at the bond under {tool} at {load}", "lower",
    ("sphere",), smooth=True,
)  # fmt: skip
def bond_stress(evidence: Evidence) -> float:
    """Peak over the bonded nodes; stress at a node is the mean of its elements."""
    record = evidence.one("sphere")
    return at_load(record, record.bond_peak_pa[record.down], evidence.load_n) * 1e-3


@metric(
    "bond_stress_shear", "kPa",
    "largest von Mises stress at the bond in the press with shear and twist, over all its steps",
    "lower", ("shear",),
)  # fmt: skip
def bond_stress_shear(evidence: Evidence) -> float:
    """Peak over the steps and the bonded nodes."""
    return float(evidence.one("shear").bond_peak_pa.max()) * 1e-3


@metric("gel_modulus", "MPa", "Young's modulus of the gel's first layer", "none", (), smooth=True)
def gel_modulus(evidence: Evidence) -> float:
    """Also of a gel that is given by its Shore hardness."""
    return evidence.parameters.layer_materials()[0].young_modulus_pa * 1e-6
