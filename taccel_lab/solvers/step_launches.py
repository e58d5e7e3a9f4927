# SPDX-License-Identifier: Apache-2.0
"""Launches that the parts of a step share: contacts, energies, motion, taking over positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from taccel_lab.ipc.branches import side_by_side
from taccel_lab.ipc.capacity import GrowingList, ListRoom, overflows
from taccel_lab.ipc.potentials.energy import sum_energies
from taccel_lab.ipc.potentials.friction import StepMotion
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import EnvProgress
from taccel_lab.solvers.report import EnvStatus
from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))


@wp.kernel
def _stop_overflowed_kernel(mask: wp.array(dtype=wp.int32), room: ListRoom, p: EnvProgress):
    """Stop environments of ``mask`` whose list was too short."""
    env = wp.tid()
    if mask[env] != 0 and overflows(env, room):
        stop(env, _CONTACT_OVERFLOW, p)


@wp.kernel
def _commit_kernel(
    mask: wp.array(dtype=wp.int32),
    trial: wp.array2d(dtype=wp.vec3d),
    trial_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
):
    """Take over positions and poses in the environments of ``mask``."""
    env, i = wp.tid()
    if mask[env] == 0:
        return
    if i < positions.shape[1]:
        positions[env, i] = trial[env, i]
    if i < poses.shape[1]:
        poses[env, i] = trial_poses[env, i]


class StepLaunches:
    """A solver's parts at work on a state, in the environments of ``progress.who``."""

    def __init__(self, solver: SolverParts, state: State) -> None:
        self.s = solver
        self.model = solver.model
        self.state = state
        self.p = solver.progress.data
        self.rules = solver.rules

    def decide(self, kernel: wp.Kernel, *inputs: object) -> None:
        """Launch one thread an environment."""
        wp.launch(kernel, dim=self.model.env_count, inputs=list(inputs), device=self.model.device)

    def commit(self, mask: wp.array, positions: wp.array, poses: wp.array) -> None:
        """Take over positions and poses in the environments of ``mask``."""
        state = self.state
        wp.launch(
            _commit_kernel,
            dim=(self.model.env_count, max(positions.shape[1], poses.shape[1])),
            inputs=[mask, positions, poses, state.positions, state.poses],
            device=self.model.device,
        )

    def collide(self, mask: wp.array, positions: wp.array) -> None:
        """Collisions at ``positions`` in the environments of ``mask``."""
        self.s.collisions.collect(mask, positions, self.s.candidates)

    def check_room(self, mask: wp.array, part: GrowingList) -> None:
        """Stop environments whose contacts did not fit; the host makes room for the next try."""
        if part.capacity:
            self.decide(_stop_overflowed_kernel, mask, part.room, self.p)

    def motion(
        self, positions: wp.array | None = None, poses: wp.array | None = None
    ) -> StepMotion:
        """Motion since the start of the step, to the state or to a trial."""
        s, state = self.s, self.state
        assert s.friction is not None
        return s.friction.motion(
            state.positions if positions is None else positions,
            s.origin,
            state.poses if poses is None else poses,
            s.origin_poses,
        )

    def together(self, parts: Sequence[Callable[[], None]]) -> None:
        side_by_side(self.model.device, parts)

    def energy(
        self,
        mask: wp.array,
        positions: wp.array,
        poses: wp.array,
        base: wp.array,
        totals: wp.array,
        known: bool = False,
    ) -> None:
        """Total potential in the environments of ``mask`` [J]: without friction in ``base``, with
        it in ``totals``. ``known``: the base is known already."""
        s = self.s

        def of_friction() -> None:
            if s.friction is not None:
                s.friction.write_energies(mask, self.motion(positions, poses))

        if known:
            of_friction()
            sum_energies(mask, None, s.contact, s.friction, base, totals)
            return
        if s.joints is not None:
            s.joints.set_frames(poses)
        stiff = [term for term in (s.inertia, s.affine, s.joints, s.load) if term is not None]

        def of_elements() -> None:
            for part in [*s.elastic, *s.viscosity]:
                part.write_energies(mask, positions)

        def of_others() -> None:
            for term in stiff:
                term.write_energies(mask, positions)

        def of_contact() -> None:
            s.contact.write_energies(mask, positions)

        self.together([of_elements, of_contact, of_friction, of_others])
        sum_energies(mask, s.energies, s.contact, s.friction, base, totals)
