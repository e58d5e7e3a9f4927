# SPDX-License-Identifier: Apache-2.0
"""The one place that says how a press is simulated: element, mesh, contact range, tolerance; and
what error that keeps to.

``press``, ``PressEnv``, previews, studies, every calibration and every data set take it from here,
so that what one fits another reproduces. What a user chooses is an ``Accuracy``.

Mesh, contact range ``dhat`` and steps part a press from the exact solution of its equations.
``measured_press`` measures them for one press; batches and previews take what a battery of presses
says of their grade, the error that 19 of 20 keep to (docs/evidence/verification.md, Presses by
default).
"""

from __future__ import annotations

import dataclasses
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.presses.mesh_options import (
    DEFAULT_PRESS_MESH,
    OutlineMeshOptions,
    PressMeshOptions,
)
from taccel_lab.scene import Ball, Element, TriangleMesh
from taccel_lab.solvers import SolverConfig

if TYPE_CHECKING:
    from taccel_lab.profile import MaterialBlock


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

    def of_press(
        self, depth_mm: float, friction: float, poisson_ratio: float, *, in_batch: bool = False
    ) -> PressPhysics:
        """Physics of one press: a contact range that is small beside its depth, as a force is off
        by ``GAP_SHARE`` of that over the depth; and layers for friction, see ``for_friction``.

        All presses of a batch share a range. With ``in_batch`` it is the grade's or a power of a
        quarter of it, the nearest, so that a force is off by 0.2 % at most and depends on its own
        depth alone, not on its company.
        """
        near = max(LEAST_DHAT_M, DHAT_OF_DEPTH * 1e-3 * depth_mm)
        if in_batch:
            near = self.dhat_m * 0.25 ** round(max(math.log(self.dhat_m / near, 4), 0.0))
        mesh = self.mesh.for_friction(poisson_ratio) if friction > 0 else self.mesh
        return replace(self, dhat_m=min(self.dhat_m, near), mesh=mesh)

    def solver(self, **changes: Any) -> SolverConfig:
        """The solver's settings; ``changes`` are of what a result does not depend on, such as
        limits of iterations."""
        return SolverConfig(
            dhat_m=self.dhat_m, relative_tolerance=self.relative_tolerance, **changes
        )

    def record(self) -> dict[str, Any]:
        """Record as JSON: for caches, results and the profile's material block."""
        record = dataclasses.asdict(self)
        for kind in ("outline", "scattered"):
            options = record["mesh"].pop(kind)
            record["mesh"] |= {f"{kind}_{name}": value for name, value in options.items()}
        return record


DHAT_OF_DEPTH, LEAST_DHAT_M = 1 / 60, 1e-6
"""Contact range of one press over its depth at most, and the least that this leads to [m]. A ball
0.1 mm deep is 0.5 to 1 % off with 1e-5 m and 0.1 to 0.2 % with this."""

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


class Shares(NamedTuple):
    """Shares of smooth tools, and of tools that may have rims."""

    smooth: float
    rims: float

    def of(self, shape: Ball | TriangleMesh) -> float:
        """Share of a tool."""
        return self.smooth if isinstance(shape, Ball) else self.rims


FORCE_SHARE = {
    Accuracy.FAST: Shares(0.034, 0.11),
    Accuracy.DEFAULT: Shares(0.034, 0.055),
    Accuracy.REFERENCE: Shares(0.01, 0.02),
}
"""Error over the force."""
HEIGHT_SHARE = {
    Accuracy.FAST: Shares(0.0095, 0.057),
    Accuracy.DEFAULT: Shares(0.0036, 0.0135),
    Accuracy.REFERENCE: Shares(0.001, 0.005),
}
"""Root mean square error of the heights over the depth."""
COARSE_ORDER = 5
"""How errors grow on meshes coarser than the grade's, by elements along a side."""
GAP_SHARE = 0.06
"""Error over the force, by what ``dhat`` is larger than the grade's, over the depth."""
LINEAR_SHARE = 0.6
"""Error over the force of linear elements on the default mesh; of first order in the elements'
size."""


@dataclass(frozen=True)
class PressError:
    """Numerical error of presses."""

    force_n: np.ndarray
    """Error of the force along the press [N], shape [env_count]."""
    height_m: np.ndarray
    """Error of the heights of the contact face, root mean square [m], shape [env_count]."""


def expected_error(
    physics: PressPhysics,
    shape: Ball | TriangleMesh,
    force_n: np.ndarray,
    depth_m: np.ndarray,
) -> PressError:
    """What presses of a grade keep to in 19 of 20 cases, on meshes made for the press.

    Args:
        physics: Grade and element; a coarser mesh or a larger contact range add to it.
        shape: What presses.
        force_n: Along the press [N], [env_count].
        depth_m: Past first touch [m], [env_count].
    """
    depth_m = np.maximum(depth_m, 0.0)
    linear, usual = physics.element is Element.LINEAR, PHYSICS[physics.accuracy]
    rule = PHYSICS[Accuracy.DEFAULT] if linear else usual
    finer = (_cells(physics, shape) / _cells(rule, shape)) ** (1 / 3)
    coarser = min(finer, 1.0) ** -COARSE_ORDER
    share = LINEAR_SHARE / finer if linear else coarser * FORCE_SHARE[physics.accuracy].of(shape)
    wider_m = max(physics.dhat_m - usual.dhat_m, 0.0)
    gap = GAP_SHARE * wider_m / np.maximum(depth_m, physics.dhat_m)
    heights = coarser * HEIGHT_SHARE[physics.accuracy].of(shape)
    return PressError((share + gap) * np.abs(force_n), heights * depth_m)


def _cells(physics: PressPhysics, shape: Ball | TriangleMesh) -> int:
    mesh = physics.mesh
    return mesh.cell_count if isinstance(shape, Ball) else mesh.outline.cell_count


_WORDS = {
    "accuracy": "accuracy",
    "element": "elements",
    "mesh": "mesh",
    "dhat_m": "contact range in metres",
    "relative_tolerance": "tolerance",
}


def physics_difference(
    material: MaterialBlock, physics: PressPhysics, friction_coefficient: float
) -> str | None:
    """One sentence on how a press differs from those that the material was fitted with.

    Args:
        material: Of the profile that is pressed.
        physics: Of the press.
        friction_coefficient: Of the press, between tool and gel.

    Returns:
        None for a press like those of the fit, and for a material that was not fitted to presses.
    """
    fitted = material.fitted_with
    if fitted is None:
        provenance = material.provenance
        if provenance.kind != "calibrated" or "young_modulus_pa" not in provenance.spread:
            return None
        return (
            "It is not recorded what this profile's material was fitted with (an older version "
            "wrote it): forces may differ by tens of per cent from those of its records. Run "
            "taccel-lab calibrate material again"
        )
    found = [
        f"{_WORDS.get(name, name)} {_plain(old)} (this press: {_plain(new)})"
        for name, old, new in _differences(fitted.physics, physics.record())
    ]
    if fitted.friction_coefficient != friction_coefficient:
        found.append(
            f"friction {fitted.friction_coefficient:g} (this press: {friction_coefficient:g})"
        )
    if not found:
        return None
    return (
        f"The material of this profile was fitted with {', '.join(found)}: the forces of this "
        "press are not those that its calibration stands for"
    )


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """Settings that differ: name, old value, new value; None for one that is missing."""
    if old.get("accuracy") != new.get("accuracy"):
        # It stands for the settings that it chooses.
        return [("accuracy", old.get("accuracy"), new.get("accuracy"))]
    found: list[tuple[str, Any, Any]] = []
    for name in sorted({*old, *new}):
        one, other = old.get(name), new.get(name)
        if isinstance(one, Mapping) and isinstance(other, Mapping):
            found += [(f"{name}.{k}", a, b) for k, a, b in _differences(one, other)]
        elif one != other:
            found.append((name, one, other))
    return found


def _plain(value: Any) -> str:
    if value is None:
        return "not stated"
    return f"{value:g}" if isinstance(value, float) else str(value)
