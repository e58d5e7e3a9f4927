# SPDX-License-Identifier: Apache-2.0
"""Launches that the parts of a step share: contacts, energies, motion, taking over positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import warp as wp

from taccel_lab.ipc.device.ragged_lists import GrowingList, ListRoom, overflows
from taccel_lab.ipc.potentials.energy import WrittenEnergies, sum_energies, written_energies
from taccel_lab.ipc.potentials.friction import StepMotion
from taccel_lab.model.env_lists import EnvList, EnvMask, ListedMask
from taccel_lab.model.launches import launch, side_by_side
from taccel_lab.solvers.env_phase import stop
from taccel_lab.solvers.env_progress import Progress
from taccel_lab.solvers.solver_parts import SolverParts
from taccel_lab.solvers.step_report import EnvStatus

wp.set_module_options({"enable_backward": False})

_CONTACT_OVERFLOW = wp.constant(int(EnvStatus.CONTACT_OVERFLOW))


@wp.kernel
def _stop_overflowed_kernel(mask: wp.array(dtype=wp.int32), room: ListRoom, p: Progress):
    """Stop environments of ``mask`` whose list was too short."""
    env = wp.tid()
    if mask[env] != 0 and overflows(env, room):
        stop(env, _CONTACT_OVERFLOW, p)


@wp.kernel
def _commit_kernel(
    mask: wp.array(dtype=wp.int32),
    trial: wp.array2d(dtype=wp.vec3d),
    trial_poses: wp.array2d(dtype=wp.transformd),
    positions: wp.array2d(dtype=wp.vec3d),  # out
    poses: wp.array2d(dtype=wp.transformd),  # out
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
    """A solver's parts at work on its ``work``, in the environments of ``progress.roster.who``, or
    in those of them that are on a list."""

    def __init__(self, solver: SolverParts, places: EnvList | None = None) -> None:
        self.s = solver
        self.model = solver.model
        self.state = solver.work
        self.p = solver.progress
        self.places = places

    def those(self, mask: EnvMask) -> ListedMask:
        """The environments of a mask, all of which are on the list if there is one."""
        return ListedMask(mask, self.places)

    @property
    def active(self) -> ListedMask:
        """Environments whose step goes on."""
        return self.those(self.p.phases.active)

    @property
    def stepping(self) -> ListedMask:
        """Environments that take part in the stage at hand like all others."""
        return self.those(self.p.phases.stepping)

    @property
    def searching(self) -> ListedMask:
        """Environments whose line search goes on."""
        return self.those(self.p.phases.searching)

    @property
    def inner(self) -> ListedMask:
        """Environments that take part in what only some do."""
        return self.those(self.p.phases.inner)

    def decide(self, kernel: wp.Kernel, *inputs: object) -> None:
        """Launch one thread an environment, with what is known of the step as the last argument."""
        launch(kernel, self.model.env_count, *inputs, self.p.struct, device=self.model.device)

    def commit(self, mask: EnvMask, positions: wp.array, poses: wp.array) -> None:
        """Take over positions and poses in the environments of ``mask``."""
        state = self.state
        inputs = [mask, positions, poses, state.positions, state.poses]
        launch(
            _commit_kernel, (self.model.env_count, max(positions.shape[1], poses.shape[1])), *inputs
        )

    def collide(self, mask: EnvMask, positions: wp.array) -> None:
        """Collisions at ``positions`` in the environments of ``mask``."""
        self.s.collisions.collect(mask, positions, self.s.candidates)

    def check_room(self, mask: EnvMask, part: GrowingList) -> None:
        """Stop environments whose contacts did not fit; the host makes room for the next try."""
        if part.capacity:
            self.decide(_stop_overflowed_kernel, mask, part.room)

    def motion(
        self, positions: wp.array | None = None, poses: wp.array | None = None
    ) -> StepMotion:
        """Motion since the start of the step, to the state or to a trial."""
        positions = self.state.positions if positions is None else positions
        return self.s.motion_to(positions, self.state.poses if poses is None else poses)

    def together(self, parts: Sequence[Callable[[], None]]) -> None:
        side_by_side(self.model.device, parts)

    @property
    def energies(self) -> WrittenEnergies:
        """What ``all_energies`` write."""
        s = self.s
        return written_energies(s.energies, s.contact, s.friction)

    def friction_energy(self, mask: EnvMask, positions: wp.array, poses: wp.array) -> None:
        """Write the energies of friction."""
        if self.s.friction is not None:
            self.s.friction.write_energies(mask, self.motion(positions, poses))

    def energy_parts(
        self, mask: EnvMask, positions: wp.array, poses: wp.array
    ) -> list[Callable[[], None]]:
        """Launches, in any order or side by side, that write the energies of all items in the
        environments of ``mask``, but for those of contact: these need collisions."""
        s = self.s

        def of_elements() -> None:
            for part in s.elements:
                part.write_energies(mask, positions)

        def of_others() -> None:
            if s.joints is not None:
                s.joints.set_frames(poses)
            for term in (s.inertia, s.affine, s.joints, s.load):
                if term is not None:
                    term.write_energies(mask, positions)

        return [of_elements, of_others, lambda: self.friction_energy(mask, positions, poses)]

    def all_energies(
        self, mask: EnvMask, positions: wp.array, poses: wp.array
    ) -> list[Callable[[], None]]:
        """``energy_parts`` and those of contact."""
        parts = self.energy_parts(mask, positions, poses)
        return [*parts, lambda: self.s.contact.write_energies(mask, positions)]

    def energy(
        self,
        mask: EnvMask,
        positions: wp.array,
        poses: wp.array,
        base: wp.array,
        totals: wp.array,
    ) -> None:
        """Total potential in the environments of ``mask`` [J]: without friction in ``base``, with
        it in ``totals``."""
        self.together(self.all_energies(mask, positions, poses))
        sum_energies(mask, self.energies, base, totals)
