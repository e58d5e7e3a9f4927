# SPDX-License-Identifier: Apache-2.0
"""Presses of gels that differ in moduli and in friction, as environments of one scene.

Environments of a scene share their moduli, but not the rest volumes of their elements. All energies
are linear in the shear modulus and in lambda (``ipc.elasticity.dilatation``; of Mooney and Rivlin's
law in both of its constants): two or three groups of elements on the same nodes, each with one
modulus of 1 Pa and with volumes scaled by what that modulus is in an environment, are another gel
in each. That is one evaluation of the elements more (of Mooney and Rivlin's law two); the rest of a
step, the linear solves above all, costs as much as ever.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import warp as wp

from taccel_lab.geometry import TetMesh
from taccel_lab.model.elastic import ElementArrays
from taccel_lab.presses import Indenter, PressEnv
from taccel_lab.presses.physics import PHYSICS, Accuracy, PressPhysics
from taccel_lab.scene import Material, MaterialField, MaterialModel
from taccel_lab.solvers import SolverConfig, SolverIPC, StepReport

wp.set_module_options({"enable_backward": False})


@dataclass(frozen=True)
class Stop:
    """Where a tool goes next."""

    depth_mm: float
    """Past first touch."""
    shift_mm: tuple[float, float] = (0.0, 0.0)
    """From the place of first touch, gel x and y."""
    read: bool = True
    """Whether something is read there; otherwise it only keeps the steps short."""


class GelPresses(PressEnv):
    """One tool on gels of one mesh, an environment each."""

    def __init__(
        self,
        mesh: TetMesh,
        materials: Sequence[Material | MaterialField],
        indenter: Indenter,
        at_mm: tuple[float, float],
        frictions: Sequence[float],
        *,
        physics: PressPhysics = PHYSICS[Accuracy.DEFAULT],
        config: SolverConfig | None = None,
        device: str = "cpu",
    ) -> None:
        """
        Args:
            mesh: Gel pad in the gel frame.
            materials: Of each environment, of one law and one largest Young's modulus, on which
                the contact stiffness depends.
            indenter: The tool.
            at_mm: xy of its axis [mm].
            frictions: Coefficient of friction of each environment.
            physics: Element, contact range and tolerance.
            config: The solver's settings; those of ``physics`` when None.
            device: Warp device.

        Raises:
            ValueError: Materials that cannot share a scene.
            InputError: As ``PressEnv``.
        """
        count = len(materials)
        if len(frictions) != count:
            raise ValueError(f"{count} materials, but {len(frictions)} coefficients of friction")
        if len({(m.model, m.largest_young_modulus_pa) for m in materials}) != 1:
            raise ValueError("environments must share the law and the largest Young's modulus")
        alike = all(_same(material, materials[0]) for material in materials[1:])
        one_friction = len(set(frictions)) == 1
        super().__init__(
            mesh,
            materials[0],
            indenter,
            np.tile(at_mm, (count, 1)),
            friction_coefficient=frictions[0] if one_friction else 1.0,
            # Volumes are to differ by environment.
            rest_positions_m=None if alike else np.tile(mesh.nodes_m, (count, 1, 1)),
            physics=physics,
            config=config,
            device=device,
        )
        if not alike:
            whole = self.model.elastic
            self.model.elastic = [g for part in whole for g in split_by_modulus(part, materials)]
            self.solver = SolverIPC(self.model, self.solver.config)
        if not one_friction:
            pad, tool = (body.name for body in self.model.bodies)
            self.model.set_friction(pad, tool, np.array(frictions, dtype=np.float64))

    def go(self, stops: Sequence[Stop], stay: np.ndarray | None = None) -> StepReport:
        """Take the tool of each environment to its stop, but for those of ``stay`` (bool, [env]).

        An environment that does not converge is left where it was, for the caller to see.
        """
        return self._step(
            self.checked_depth_m(np.array([stop.depth_mm for stop in stops])),
            np.array([stop.shift_mm for stop in stops]) * 1e-3,
            np.zeros(len(stops)),
            stay,
        )


def split_by_modulus(
    group: ElementArrays, materials: Sequence[Material | MaterialField]
) -> list[ElementArrays]:
    """Groups of the same elements, one a modulus, whose volumes carry the moduli of environments.

    The energy is sum_q V/4 psi(F_q; mu) + V l u(mean dilatation) and psi is linear in mu, for
    Mooney and Rivlin's law in mu (1 - r) and mu r, with l = lambda - 2 r mu there.
    """
    shape = (len(materials), group.element_count)
    mu = np.array([np.broadcast_to(m.shear_modulus_pa, shape[1:]) for m in materials])
    lam = np.array([np.broadcast_to(m.lame_lambda_pa, shape[1:]) for m in materials])
    volumes = np.broadcast_to(group.volumes.numpy(), shape)
    if group.law is not MaterialModel.MOONEY_RIVLIN:
        terms = [((1.0, 0.0, 0.0), mu), ((0.0, 1.0, 0.0), lam)]
    else:
        r = np.array([np.broadcast_to(m.mooney_ratio, shape[1:]) for m in materials])
        # With r = 1 a lambda of 2 mu leaves l = 0.
        terms = [
            ((1.0, 0.0, 0.0), mu * (1 - r)),
            ((1.0, 2.0, 1.0), mu * r),
            ((0.0, 1.0, 0.0), lam - 2 * r * mu),
        ]
    device = group.volumes.device

    def put(values: np.ndarray) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=wp.float64, device=device)

    def filled(value: float) -> wp.array:
        return put(np.full(shape[1], value))

    return [
        replace(
            group,
            mu=filled(one_mu),
            lam=filled(one_lam),
            mooney_ratio=filled(ratio) if len(group.mooney_ratio) else group.mooney_ratio,
            volumes=put(volumes * scale),
        )
        for (one_mu, one_lam, ratio), scale in terms
    ]


def _same(first: Material | MaterialField, second: Material | MaterialField) -> bool:
    names = ("shear_modulus_pa", "lame_lambda_pa", "mooney_ratio")
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)
