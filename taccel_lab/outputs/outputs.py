# SPDX-License-Identifier: Apache-2.0
"""``Outputs``: read what a step did. Only what is read is computed, once for each update."""

from __future__ import annotations

import warnings
from functools import cached_property

import numpy as np
import warp as wp

from taccel_lab.errors import InputWarning
from taccel_lab.model import BodyKind
from taccel_lab.model.turns import in_turn
from taccel_lab.outputs.arrays import negated
from taccel_lab.outputs.contact_wrenches import (
    PairWrenches,
    contact_wrenches,
    friction_wrenches,
)
from taccel_lab.outputs.guard_share import MOST_SHARE, guard_shares
from taccel_lab.outputs.momentum import Momentum, MomentumReader
from taccel_lab.outputs.sliding import Sliding, read_sliding
from taccel_lab.outputs.soft_wrenches import SoftWrenchReader
from taccel_lab.outputs.stress import StressReader, peak_at, von_mises
from taccel_lab.outputs.surface_load import SurfaceLoad, SurfaceLoadReader
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.state import State, check_state
from taccel_lab.typed import typed

_STORED = ("elastic", "affine", "joints")
"""Potentials whose value is energy that is stored, not a means to a step."""


@typed
class Outputs:
    """Construct once, ``update(state)`` after a step, then read.

    Forces, wrenches, gaps and sliding are those of the last step of the solver; of another state
    they are rejected. Arrays that were handed out keep their values at the next update.
    """

    @in_turn
    def __init__(self, solver: SolverIPC) -> None:
        self._solver = solver
        self._model = solver.model
        self._state: State | None = None
        self._momentum = MomentumReader(self._model)
        self._surface_load = SurfaceLoadReader(self._model)
        self._soft_wrenches = SoftWrenchReader(solver)

    def update(self, state: State) -> Outputs:
        """Read from now on the step that led to ``state``.

        Raises:
            InputError: A state of another model.
        """
        check_state(state, self._model)
        self._state = state
        for name, value in vars(type(self)).items():
            if isinstance(value, cached_property):
                self.__dict__.pop(name, None)
        return self

    @property
    def state(self) -> State:
        """The state of the last update."""
        if self._state is None:
            raise RuntimeError("update() must be called before an output is read")
        return self._state

    @property
    def _latest(self) -> State:
        """The state, of which the solver knows the forces."""
        self._solver.require_latest(self.state)
        return self.state

    # Contact ---------------------------------------------------------------------------------

    @cached_property
    @in_turn
    def normal_forces(self) -> wp.array:
        """Contact force on each node [N], vec3d, shape [env_count, node_count]."""
        _ = self._latest
        return negated(self._solver.contact_gradient)

    @cached_property
    @in_turn
    def friction_forces(self) -> wp.array:
        """Friction force on each node [N], vec3d, shape [env_count, node_count]."""
        _ = self._latest
        return negated(self._solver.friction_gradient)

    @in_turn
    def soft_wrenches(self, who: np.ndarray | None = None) -> wp.array:
        """Return force and torque of contact and friction on each soft body, about the origin.
        Axes are those of its mesh where a mount carries it (``GelFrames``), of a kinematic mount
        those of the mount, and of the world where it has none. (Fx, Fy, Fz, Mx, My, Mz) [N, N m],
        six float64, shape [env_count, soft_count]. Does not wait for the device.

        ``who``: environments to read, bool, [env_count], of the host, a row for each; all when
        None.
        """
        return self._soft_wrenches.read(self.state, who)

    @cached_property
    @in_turn
    def surface_load(self) -> SurfaceLoad:
        """Tractions of contact and friction, and contact pressure, on the surface as it is now."""
        x = self.state.positions
        return self._surface_load.read(x, self.normal_forces, self.friction_forces)

    @cached_property
    @in_turn
    def sliding(self) -> Sliding:
        """How far surfaces slid over each other in the step, and where friction is at its limit;
        InputError in a scene without friction."""
        return read_sliding(self._solver, self.state)

    @in_turn
    def contact_wrenches(self, center_m: tuple[float, float, float] = (0, 0, 0)) -> PairWrenches:
        """Normal forces between bodies, torques about ``center_m``, and gaps."""
        collisions = self._solver.collisions
        return contact_wrenches(self._model, collisions, self._latest.positions, center_m)

    @in_turn
    def friction_wrenches(self, center_m: tuple[float, float, float] = (0, 0, 0)) -> PairWrenches:
        """Friction forces between bodies, torques about ``center_m``."""
        s, state = self._solver, self._latest
        if s.friction is None:
            return PairWrenches.none(self._model)
        motion = s.motion_to(state.positions, state.poses)
        geometry = s.collisions.geometry
        return friction_wrenches(self._model, s.friction, geometry, motion, center_m)

    @in_turn
    def guard_shares(self) -> np.ndarray:
        """Part of the force on each kinematic body that depends on the guard against inverted
        elements [1], [env_count, kinematic_count]: 0 where none is near it, NaN where the gel is
        about to buckle. Takes a linear solve a body where the guard acts. Warns (``InputWarning``)
        above a hundredth: the gel is pressed past what its mesh resolves.

        Raises:
            InputError: The guard acts in a scene with inertia or affine bodies.
        """
        shares = guard_shares(self._solver, self._latest)
        names = [body.name for body in self._model.bodies if body.kind is BodyKind.KINEMATIC]
        for name, share in zip(names, shares.T, strict=True):
            most = float(np.max(share, initial=0.0, where=~np.isnan(share)))
            if most > MOST_SHARE:
                said = (
                    f"the guard against inverted elements carries {100 * most:.2g} % of the force "
                    f"on {name!r}: the gel is pressed past what its mesh resolves"
                )
                warnings.warn(InputWarning(said), stacklevel=3)
        return shares

    # Stress ----------------------------------------------------------------------------------

    @cached_property
    @in_turn
    def nodal_stresses(self) -> wp.array:
        """Cauchy stress at the nodes of soft bodies [Pa], mat33d, shape [env_count, node_count];
        zero elsewhere."""
        positions = self.state.positions
        nodal = wp.zeros(positions.shape, dtype=wp.mat33d, device=positions.device)
        for reader in self._read_stress():
            reader.add_to_nodes(nodal)
        return nodal

    @cached_property
    @in_turn
    def von_mises(self) -> wp.array:
        """Equivalent stress at the nodes of soft bodies [Pa], float64, [env_count, node_count]."""
        return von_mises(self.nodal_stresses)

    @in_turn
    def bond_peak(self) -> tuple[wp.array, wp.array]:
        """Largest equivalent stress at a bonded node [Pa] and that node, [env_count] each."""
        held = self._model.free_index.numpy() < 0
        soft = [body.nodes for body in self._model.bodies if body.kind is BodyKind.SOFT]
        nodes = [np.arange(*nodes)[held[slice(*nodes)]] for nodes in soft]
        return peak_at(np.concatenate([np.zeros(0), *nodes]), self.von_mises)

    def _read_stress(self) -> list[StressReader]:
        readers = [StressReader(self._model, group) for group in self._model.elastic]
        for reader in readers:
            reader.read(self.state.positions, self.state.viscous_inverses)
        return readers

    # Energy and momentum ---------------------------------------------------------------------

    @in_turn
    def momentum(self, center_m: tuple[float, float, float] = (0, 0, 0)) -> Momentum:
        """Momenta and kinetic energies of the bodies, angular momenta about ``center_m``."""
        return self._momentum.read(self.state.positions, self.state.velocities, center_m)

    @cached_property
    @in_turn
    def energies(self) -> dict[str, np.ndarray]:
        """Stored energies by name [J], shape [env_count]: elastic, affine, joints, contact, weight,
        kinetic; those that the scene has."""
        s, x = self._solver, self._latest.positions
        everyone = wp.full(self._model.env_count, 1, dtype=wp.int32, device=self._model.device)
        terms = {
            name: part.energy(everyone, x).copy()
            for name, part in s.potentials.items()
            if name.split()[0] in _STORED
        }
        terms["contact"] = s.contact.energy(everyone, x)
        if s.inertia is not None:
            terms["weight"] = self._momentum.read_weight_energy(x).numpy().sum(axis=1)
            terms["kinetic"] = self.momentum().kinetic_energy.numpy().sum(axis=1)
        return terms
