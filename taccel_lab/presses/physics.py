# SPDX-License-Identifier: Apache-2.0
"""The one place that says how a press is simulated: element, mesh, contact range, tolerance.

``press``, ``PressEnv``, previews, studies, every calibration and every data set take it from here,
so that what one fits another reproduces. What a user chooses is an ``Accuracy``.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from taccel_lab.errors import InputError
from taccel_lab.geometry.press_mesh_options import (
    DEFAULT_PRESS_MESH,
    OutlineMeshOptions,
    PressMeshOptions,
)
from taccel_lab.scene import Element
from taccel_lab.solvers import SolverConfig


class Accuracy(StrEnum):
    """How closely a press is simulated."""

    FAST = "fast"
    DEFAULT = "default"
    REFERENCE = "reference"


LEAST_SHARE, LARGEST_SHARE = 0.005, 0.5
"""Errors that may be asked for."""


def parse_accuracy(text: str) -> Accuracy | float:
    """A grade, or the relative error of the force that is asked for [1], such as 0.03 of ``3%``.

    Raises:
        InputError: Neither a grade nor a percentage, or one that no press can keep.
    """
    if text in {*Accuracy}:
        return Accuracy(text)
    found = re.fullmatch(r"\s*(\d+\.?\d*|\.\d+)\s*%\s*", text)
    if found is None:
        raise InputError(
            f"accuracy {text!r} is not known; allowed: {', '.join(Accuracy)}, or the largest error "
            "of the force in per cent, such as 3%"
        )
    share = float(found[1]) / 100
    if not LEAST_SHARE <= share <= LARGEST_SHARE:
        raise InputError(
            f"accuracy {text} is not possible; use {LEAST_SHARE:.1%} to {LARGEST_SHARE:.0%}"
        )
    return share


@dataclass(frozen=True)
class PressPhysics:
    """All that decides a simulated press besides sensor, material, tool, friction and path."""

    accuracy: Accuracy = Accuracy.DEFAULT
    element: Element = Element.QUADRATIC
    mesh: PressMeshOptions = DEFAULT_PRESS_MESH
    dhat_m: float = 1e-5
    """Gap at which contact begins."""
    relative_tolerance: float = 1e-4
    """Force residual over the sum of the contact forces at which a step has converged."""

    def solver(self, **changes: Any) -> SolverConfig:
        """The solver's settings; ``changes`` are of what a result does not depend on, such as
        limits of iterations."""
        return SolverConfig(
            dhat_m=self.dhat_m, relative_tolerance=self.relative_tolerance, **changes
        )

    def record(self) -> dict[str, Any]:
        """As JSON: for caches, results and the profile's material block."""
        record = dataclasses.asdict(self)
        for kind in ("outline", "scattered"):
            options = record["mesh"].pop(kind)
            record["mesh"] |= {f"{kind}_{name}": value for name, value in options.items()}
        return record


PHYSICS: dict[Accuracy, PressPhysics] = {
    Accuracy.FAST: PressPhysics(
        Accuracy.FAST, mesh=PressMeshOptions(rings=8, outline=OutlineMeshOptions(outer=4, layers=3))
    ),
    Accuracy.DEFAULT: PressPhysics(),
    Accuracy.REFERENCE: PressPhysics(
        Accuracy.REFERENCE,
        mesh=PressMeshOptions(
            elements_per_radius=9.0,
            core=10,
            rings=16,
            layers=5,
            outline=OutlineMeshOptions(core=8, inner=5, outer=11, layers=6, top=0.04),
            scattered=OutlineMeshOptions(core=20, inner=2, outer=8, layers=5, top=0.05),
        ),
        dhat_m=3e-6,
        relative_tolerance=1e-5,
    ),
}

SURFACE_PHYSICS = dataclasses.replace(
    PHYSICS[Accuracy.DEFAULT],
    mesh=PressMeshOptions(elements_per_radius=5.0, core=6, rings=10, layers=3),
)
"""Of surfaces that colours and normals are fitted to: as by default, with nodes a tenth of the
contact's radius apart. Forces need fewer, slopes beside a contact do not."""
