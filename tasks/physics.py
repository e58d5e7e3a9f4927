# SPDX-License-Identifier: Apache-2.0
"""Physics that tasks have in common; it reads no files, and so needs no pydantic."""

from __future__ import annotations

from typing import TYPE_CHECKING

from taccel_lab.solvers import SolverConfig

if TYPE_CHECKING:
    from taccel_lab.tasks.parameters import Contact

G = 9.81
"""Gravity [m/s^2], downwards."""


def contact_config(contact: Contact) -> SolverConfig:
    """Settings of the solver, of a scene with inertia."""
    return SolverConfig(
        dhat_m=1e-3 * contact.dhat_mm,
        friction_speed_m_s=1e-3 * contact.friction_speed_mm_s,
        absolute_tolerance_n=contact.absolute_tolerance_n,
    )
