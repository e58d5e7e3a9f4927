# SPDX-License-Identifier: Apache-2.0
"""How far the tool of a press slides over the gel, before it is pressed."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from taccel_lab.geometry.contact_sweep import ContactSweep
from taccel_lab.geometry.tool_section import ToolSection
from taccel_lab.presses.bonded_layer import layer_force_n
from taccel_lab.presses.indenter import Indenter
from taccel_lab.presses.path import PressPath, rolled_mm
from taccel_lab.scene import Ball

_BALL_SHARE = 2 / 3
"""Force of a ball over that of a flat punch of its contact radius, as deep [Hertz]."""


def path_contact(
    indenter: Indenter,
    path: PressPath,
    friction: float,
    thickness_mm: float,
    poisson_ratio: float,
) -> tuple[float | ToolSection, ContactSweep]:
    """Contact of a press, see ``Indenter.contact``, and its way, see ``press_sweep``; a ball that
    rolls takes its contact along."""
    contact = indenter.contact(path.depth_mm)
    sweep = press_sweep(path, contact, friction, thickness_mm, poisson_ratio)
    if any(path.roll_deg) and isinstance(indenter.shape, Ball):
        height = np.array([1e3 * indenter.shape.radius_m])
        x, y = sweep.way_mm + rolled_mm(path.commands()[-1:], height)[0]
        return contact, ContactSweep((float(x), float(y)))
    return contact, sweep


def press_sweep(
    path: PressPath,
    contact: float | ToolSection,
    friction: float,
    thickness_mm: float,
    poisson_ratio: float,
) -> ContactSweep:
    """Way of the contact of a press over the gel, about.

    The gel goes with the tool until the sideways force is ``friction`` times the normal one. It
    resists as a half-space under a rigid disc and as a layer in simple shear, k = 8 G a / (2 - nu)
    + G pi a^2 / h [Johnson 1985, 3.6 and 7.2]; a punch that takes 0.70 N/mm has 0.69 by that.

    Args:
        path: Of the press.
        contact: What of the gel is touched, see ``Indenter.contact``.
        friction: Coefficient.
        thickness_mm: Of the gel.
        poisson_ratio: Of the gel.
    """
    whole = ContactSweep(path.shear_mm, path.twist_deg)
    if isinstance(contact, ToolSection):
        # A rim that sticks stays above the rows that it came down on.
        return replace(whole, slip=0.0) if friction > 0 else whole
    travel = math.hypot(*path.shear_mm) + math.radians(abs(path.twist_deg)) * contact
    if friction == 0 or travel == 0:
        return whole
    depth = np.array([path.depth_mm])
    normal = layer_force_n("cylinder", depth, contact, thickness_mm, min(poisson_ratio, 0.5))
    # N per Pa and N/mm per Pa: 1e-6 m^2 a mm^2.
    modulus = 1e-6 / (2 * (1 + poisson_ratio))
    disc = 8 * contact / (2 - poisson_ratio) + math.pi * contact**2 / thickness_mm
    dragged = friction * _BALL_SHARE * float(normal[0]) / (modulus * disc)
    return replace(whole, slip=max(0.0, 1.0 - dragged / travel))
