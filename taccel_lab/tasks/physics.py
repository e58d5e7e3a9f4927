# SPDX-License-Identifier: Apache-2.0
"""Physics that tasks have in common; it reads no files, and so needs no pydantic."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from taccel_lab.solvers import SolverConfig

if TYPE_CHECKING:
    from taccel_lab.tasks.parameters import Contact

G = 9.81
"""Gravity [m/s^2], downwards."""


def contact_config(contact: Contact, quasi_static_s: float | None = None) -> SolverConfig:
    """Settings of the solver, of a scene with inertia, or of one without that takes steps of
    ``quasi_static_s``."""
    config = SolverConfig(
        dhat_m=1e-3 * contact.dhat_mm, absolute_tolerance_n=contact.absolute_tolerance_n
    )
    speed = 1e-3 * contact.friction_speed_mm_s
    if quasi_static_s is None:
        return replace(config, friction_speed_m_s=speed)
    return replace(config, friction_eps_m=speed * quasi_static_s)
