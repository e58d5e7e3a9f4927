# SPDX-License-Identifier: Apache-2.0
"""What a solver holds for a model: the potentials that its scene needs, contacts, arrays.

A user's state is read into arrays that a solver works on, and written back, by environments. One
launch moves all arrays. Where they are stands in device memory, so that a captured step serves
every state: another one costs a copy of a dozen addresses.
"""

from __future__ import annotations

import math

import numpy as np
import warp as wp

from taccel_lab.ipc.broad_phase.candidates import Candidates
from taccel_lab.ipc.broad_phase.kept_pairs import KeptPairs
from taccel_lab.ipc.contact.collisions import Collisions
from taccel_lab.ipc.device.ragged_lists import GrowingList, initial_capacity
from taccel_lab.ipc.linear.system import LinearSystem
from taccel_lab.ipc.motion.trial import FrameNodes, StraightNodes
from taccel_lab.ipc.potentials.contact import ContactPotential
from taccel_lab.ipc.potentials.elements.elastic import ElasticPotential
from taccel_lab.ipc.potentials.elements.inversion import BEARS_INVERSION
from taccel_lab.ipc.potentials.energy import Potential, share_buffer
from taccel_lab.ipc.potentials.external import ExternalLoad
from taccel_lab.ipc.potentials.friction import FrictionPotential, StepMotion, step_motion
from taccel_lab.ipc.potentials.inertia import InertiaPotential
from taccel_lab.model import Model
from taccel_lab.model.env_rows import lane_count
from taccel_lab.model.launches import Scratch, launch
from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.env_progress import (
    EnvProgress,
    list_places,
    make_rules,
)
from taccel_lab.solvers.step_orders import StepOrders
from taccel_lab.state import State, StepHistory, no_viscous_strain

wp.set_module_options({"enable_backward": False})


_MOST = 13
"""Arrays of a state, at most."""


@wp.kernel
def _move_rows_kernel(
    mask: wp.array(dtype=wp.int32),
    also: wp.array(dtype=wp.int32),
    lanes: int,
    count: int,
    widths: wp.array(dtype=wp.int32),
    sources: wp.array(dtype=wp.uint64),
    targets: wp.array(dtype=wp.uint64),
):
    """Rows of the first ``count`` arrays, of the environments of both masks."""
    env, lane = wp.tid()
    if mask[env] == 0 or also[env] == 0:
        return
    for k in range(count):
        width = widths[k]
        shape = (mask.shape[0], width)
        source = wp.array(ptr=sources[k], shape=shape, dtype=wp.float64)
        target = wp.array(ptr=targets[k], shape=shape, dtype=wp.float64)
        for i in range(lane, width, lanes):
            target[env, i] = source[env, i]


def _addresses(arrays: list[wp.array]) -> list[int]:
    return [array.ptr or 0 for array in arrays]


class StateRows:
    """Moves rows between a solver's ``work`` and the state that it was pointed at last."""

    def __init__(self, model: Model, work: State) -> None:
        self._model, self._work = model, work
        device = model.device
        self._widths = wp.zeros(_MOST, dtype=wp.int32, device=device)
        self._mine = wp.zeros(_MOST, dtype=wp.uint64, device=device)
        self._theirs = wp.zeros(_MOST, dtype=wp.uint64, device=device)
        self.overlapping = wp.zeros(1, dtype=wp.uint64, device=device)
        """Where ``State.unsearched`` stands; 0 where overlaps are not looked for."""
        self._known: tuple[list[int], list[int], list[int]] = ([], [], [])
        self._lanes = lane_count(device, model.env_count, 3 * model.node_count)

    def point(self, state: State, checked: bool) -> bool:
        """Move to and from ``state`` from now on, and read from it where bodies overlap if that is
        ``checked``. Returns whether ``work`` has other arrays now, so that a graph that moves them
        is stale."""
        loads = (state.external_forces, state.wrenches, self._work.external_forces)
        if any(array is not None for array in loads):
            state.loads(self._model)
            self._work.loads(self._model)
        mine = [*self._work.motion(), *self._work.asked()]
        flags = [] if state.unsearched is None or not checked else [state.unsearched]
        theirs = [*state.motion(), *state.asked()]
        addresses = _addresses(mine), _addresses(theirs), _addresses(flags)
        changed = addresses[0] != self._known[0]
        if addresses != self._known:
            # Of no state while it is written: that may be interrupted.
            self._known = ([], [], [])
            entries = [wp.types.type_size_in_bytes(array.dtype) // 8 for array in mine]
            widths = [n * math.prod(a.shape[1:]) for n, a in zip(entries, mine, strict=True)]
            rows = (np.array(widths, dtype=np.int32), *np.array(addresses[:2], dtype=np.uint64))
            for array, row in zip((self._widths, self._mine, self._theirs), rows, strict=True):
                array.assign(np.pad(row, (0, _MOST - len(row))))
            self.overlapping.assign(np.array(addresses[2] or [0], dtype=np.uint64))
            self._known = addresses
        return changed

    def read(self, mask: wp.array) -> None:
        """Reads into ``work`` in the environments of ``mask``, int32, [env_count]."""
        count = len(self._work.motion()) + len(self._work.asked())
        self._move(mask, mask, count, self._theirs, self._mine)

    def write(self, mask: wp.array, also: wp.array) -> None:
        """What steps change, from ``work``, in the environments of both masks, int32, [env_count]:
        in one launch, so that no interrupt leaves a half of it."""
        self._move(mask, also, len(self._work.motion()), self._mine, self._theirs)

    def _move(
        self, mask: wp.array, also: wp.array, count: int, sources: wp.array, targets: wp.array
    ) -> None:
        inputs = [mask, also, self._lanes, count, self._widths, sources, targets]
        launch(_move_rows_kernel, (self._model.env_count, self._lanes), *inputs)


class SolverParts:
    """Potentials, contact search, linear solver and arrays; what the scene does not need is not
    built."""

    def __init__(self, model: Model, config: SolverConfig | None = None) -> None:
        self.model = model
        scene = model.scene
        self.config = (config or SolverConfig()).within(scene)
        self.elastic = [ElasticPotential(model, group) for group in model.elastic]
        """One for each group of elements that share a law and a kind."""
        self.invertible = [part for part in self.elastic if part.group.law in BEARS_INVERSION]
        """Potentials whose energy bears elements that are inside out, at the start and at the
        end."""
        self.inertia = None if scene.time.quasi_static else InertiaPotential(model)
        self.maxwell = self._maxwell()
        """One for each Maxwell branch of a group of elements."""
        self.elements = [*self.elastic, *self.maxwell]
        """All potentials of elements."""
        self.affine = None
        if scene.affine_bodies:
            from taccel_lab.ipc.potentials.affine import AffinePotential

            self.affine = AffinePotential(model)
        self.joints = None
        if scene.joints:
            from taccel_lab.ipc.potentials.joints import JointPotential

            self.joints = JointPotential(model)
        self.load: ExternalLoad | None = None
        """Built by the first step of a state with external forces."""
        limit = self.config.max_collisions
        self.candidates = Candidates(model, limit=limit)
        same = self.config.deterministic
        kappa, dhat = self.config.kappa_pa, self.config.dhat_m
        self.collisions = Collisions(model, kappa, dhat, limit=limit, in_order=same)
        self.pairs = KeptPairs(model, self.candidates, self.config.dhat_m)
        own = any(i == j for i, j in model.contact_plan.pairs)
        self.frame_nodes = FrameNodes(model)
        self.straight_nodes = StraightNodes(model)
        self.shortest_range_m = 0.0 if own else self.collisions.guard
        """Gap below which every pair is a collision [m]; of self-contact nothing is known."""
        self.contact = ContactPotential(model, self.collisions, same)
        static_range = self.config.static_range_m(scene.time)
        self.friction = (
            FrictionPotential(model, self.collisions, static_range, same) if model.rubs else None
        )
        first = model.free_count - 4 * model.affine.count
        self.linear = LinearSystem(
            model.pattern,
            model.env_count,
            model.device,
            method=self.config.linear_method,
            clusters=[(first + 4 * i, first + 4 * i + 4) for i in range(model.affine.count)],
            extra_room=self._extra_room(),
            scratch=self._scratch(),
            positions_m=model.rest_positions.numpy()[0, model.free_nodes.numpy()],
            held=model.held_rows(),
            in_any_order=same,
        )
        shape, device = (model.env_count, model.node_count), model.device

        def nodal() -> wp.array:
            return wp.zeros(shape, dtype=wp.vec3d, device=device)

        poses = (model.env_count, len(model.kinematic))
        self.work = State(
            positions=nodal(),
            velocities=nodal(),
            poses=wp.zeros(poses, dtype=wp.transformd, device=device),
            history=StepHistory.empty(model) if scene.time.bdf2 else None,
            joints=None if self.joints is None else self.joints.state,
            viscous_inverses=no_viscous_strain(model) if self.maxwell else None,
        )
        """What a step works on: read from a user's state when the step begins, written to it when
        the step is over."""
        self.rows = StateRows(model, self.work)
        self.gradient, self.trial, self.previous = nodal(), nodal(), nodal()
        self.displacements = nodal()
        self.origin = nodal()
        """Where the nodes were when the step began [m]: sliding counts from there. Other than
        ``previous`` in a step that is taken again from where it had ended."""
        self.contact_gradient = nodal()
        """d(barrier)/dx at the end of the step [N]; the force on a node is its negative."""
        self.friction_gradient = nodal()
        """d(friction)/dx at the end of the step [N]; the force on a node is its negative."""
        self.path = nodal() if model.kinematic or self.affine else self.trial
        """Way of a trial in which a body turns [m]."""
        pivots = (model.env_count, model.affine.count)
        self.pivots = wp.zeros(pivots, dtype=wp.vec3d, device=device)
        """What each affine body turns about in a step, from its centre [m]."""
        self.reduced = wp.zeros((model.env_count, model.free_count), dtype=wp.vec3d, device=device)
        """Gradient of the total energy by the unknowns [N]."""
        self.dts = wp.zeros(model.env_count, dtype=wp.float64, device=device)
        """Length of the step that each environment is in, or of its last one [s], float64."""
        dt_s = scene.time.dt_s
        self.whole_dts = wp.full(model.env_count, dt_s, dtype=wp.float64, device=device)
        """Length of a step that has the whole static range of friction [s], float64: of the scene's
        steps; of quasi-static steps, which may have any, that of the whole step."""
        self._dt = 0.0
        """The same where all have one; not a number where they differ."""
        self._rounds = 0
        """What ``progress.flags.most_rounds`` holds; 0 when that is not known."""
        self.trial_poses = wp.zeros_like(self.work.poses)
        self.target_poses = wp.zeros_like(self.trial_poses)
        self.start_poses = wp.zeros_like(self.trial_poses)
        self.end_poses = wp.zeros_like(self.trial_poses)
        self.orders = StepOrders(model.env_count, len(model.kinematic), device)
        """Masks of ``progress.roster``, and ``end_poses`` of steps that begin from now on."""
        self.origin_poses = wp.zeros_like(self.trial_poses)
        self.body_rows = wp.array(model.body_rows(), dtype=wp.vec2i, device=device)
        """Range of each body in ``reduced``, vec2i, shape [body_count]."""
        ranges = [body.nodes for body in model.bodies]
        self.body_nodes = wp.array(ranges, dtype=wp.vec2i, device=device)
        """Range of each body in the nodes, vec2i, shape [body_count]."""
        rules = make_rules(
            self.config,
            self.affine.rounding_n if self.affine else 0.0,
            self.affine.energy_rounding if self.affine else 0.0,
            self.joints.tolerance_m if self.joints else None,
            self.friction is not None,
            self.inertia is None and self.affine is None and not model.contact_plan.soft_to_soft,
        )
        soft = len(scene.soft_bodies)
        carriers = [soft + i if i >= 0 else -1 for i in scene.carriers]
        self.progress = EnvProgress(
            model.env_count,
            len(model.bodies),
            carriers if any(i >= 0 for i in carriers) else [],
            model.kinematic_radii_m,
            rules,
            self.orders.masks,
            device,
        )
        self.few_places, self.some_places = list_places(model)
        self.share_energies()

    def limit_rounds(self, most: int) -> None:
        """Set the rounds after which a call ends, whoever is underway."""
        if self._rounds != most:
            self.progress.flags.most_rounds.fill_(most)
            self._rounds = most

    @property
    def active(self) -> wp.array:
        """Mask of the environments that a step works on, int32, shape [env_count]."""
        return self.progress.phases.active

    def find_contacts(self, mask: wp.array, state: State) -> None:
        """Find the collisions of a state in the environments of ``mask``, and make room for them;
        ``displacements`` become zero."""
        x, poses = state.positions, state.poses
        self.displacements.zero_()
        self.candidates.update(mask, x, self.displacements, poses, poses, self.config.dhat_m)
        self.pairs.forget(mask)
        self.collisions.update(mask, x, self.candidates)

    def motion_to(self, positions: wp.array, poses: wp.array) -> StepMotion:
        """Motion since the start of the step, which sliding is measured from."""
        return step_motion(self.model, positions, self.origin, poses, self.origin_poses)

    def _scratch(self) -> Scratch:
        """Memory of the elements, which are idle during a solve."""
        idle = [part.idle_memory for part in self.elements]
        return Scratch(max(idle, key=lambda memory: memory.capacity) if idle else None)

    def _extra_room(self) -> int:
        """Room for contact of two free bodies that does not fit the pattern of the matrix."""
        model = self.model
        if model.affine.count and model.scene.soft_bodies and not model.contact_in_pattern:
            return initial_capacity(model.env_count)
        return 32 if model.affine.count > 1 or model.contact_plan.soft_to_soft else 1

    def share_energies(self) -> None:
        """One buffer for the energies of all terms; graphs that used the old one are stale."""
        model = self.model
        self.energies = share_buffer(list(self.potentials.values()), model.env_count, model.device)
        """Energies of all items of ``potentials`` [J], [env_count, all items]."""

    def _maxwell(self) -> list:
        if not self.model.viscous_point_count:
            return []
        from taccel_lab.ipc.potentials.elements.maxwell import MaxwellPotential

        return [
            MaxwellPotential(self.model, group, branch, first)
            for group in self.model.elastic
            for branch, first in group.branch_points
        ]

    @property
    def potentials(self) -> dict[str, Potential]:
        """Terms of the energy by name, without contact and friction."""
        terms: dict[str, Potential | None] = {}
        for i, part in enumerate(self.elastic):
            terms["elastic" if i == 0 else f"elastic {i + 1}"] = part
        for i, part in enumerate(self.maxwell):
            terms["Maxwell branch" if i == 0 else f"Maxwell branch {i + 1}"] = part
        terms |= {
            "inertia": self.inertia,
            "affine": self.affine,
            "joints": self.joints,
            "external": self.load,
        }
        return {name: term for name, term in terms.items() if term is not None}

    @property
    def lists(self) -> list[GrowingList]:
        """Lists of contacts, which grow when they are too short."""
        return [*self.candidates.lists, self.collisions, self.linear.extra]
