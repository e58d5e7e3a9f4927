# SPDX-License-Identifier: Apache-2.0
"""Places of a gel once a ball has come down on it, about: the search for a step starts there.

- Until the ball touches, each column of the gel along the press is squeezed evenly by what the ball
  will take of it. That is no solution, as nothing gives way sideways, but a ball that comes 0.6 mm
  deep at once needs 6 iterations in place of 21.
- After that all goes on as in the last step, by as much as the ball does, and nodes that would be
  in it are put beside it.
- Nodes at the ball then get the gap at which contact bears what the gel pushes them with. Contact
  is so stiff that a third of all iterations went into these gaps.

From where the gel was, most iterations go into taking it along, as the tool can come no nearer than
the gel has given way.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from taccel_lab.ipc.contact.barrier import unit_gap
from taccel_lab.ipc.contact.narrow_phase import ContactSurface, pair_kappa
from taccel_lab.model.launches import launch
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

wp.set_module_options({"enable_backward": False})

_GAP = wp.constant(wp.float64(0.6))
"""Gap to the ball, over the contact range: about that of a contact that presses."""
_FASTEST = 2.0
"""Longest step over the last one that all goes on in as it did there."""
_LEAST_GAP = wp.constant(wp.float64(0.3))


@wp.func
def _taken(x: wp.vec3d, top: wp.float64, centre: wp.vec3d, radius: wp.float64) -> wp.float64:
    """Length of the column through ``x`` that a ball takes [m]."""
    across_sq = wp.pow(x[0] - centre[0], wp.float64(2.0)) + wp.pow(
        x[1] - centre[1], wp.float64(2.0)
    )
    chord_sq = radius * radius - across_sq
    if chord_sq <= wp.float64(0.0):
        return wp.float64(0.0)
    return wp.max(top - centre[2] + wp.sqrt(chord_sq), wp.float64(0.0))


@wp.kernel
def _way_ahead_kernel(
    rest: wp.array2d(dtype=wp.vec3d),
    tops: wp.array(dtype=wp.float64),
    shares: wp.array(dtype=wp.float64),
    positions: wp.array2d(dtype=wp.vec3d),
    velocities: wp.array2d(dtype=wp.vec3d),
    poses: wp.array2d(dtype=wp.transformd),
    targets: wp.array2d(dtype=wp.transformd),
    touches: wp.array(dtype=wp.float64),
    radius: wp.float64,
    dhat: wp.float64,
    places: wp.array2d(dtype=wp.vec3d),
):
    env, node = wp.tid()
    was = wp.transform_get_translation(poses[env, 0])
    centre = wp.transform_get_translation(targets[env, 0])
    place = wp.vec3d()
    if was[2] > touches[env]:
        place = rest[env % rest.shape[0], node]
        taken = _taken(place, tops[node], centre, radius + _GAP * dhat)
        place[2] = place[2] - shares[node] * taken
    else:
        # The only node of a ball follows those of the gel.
        speed = velocities[env, tops.shape[0]][2]
        place = positions[env, node]
        if speed != wp.float64(0.0):
            place += (centre[2] - was[2]) / speed * velocities[env, node]
    least = radius + _LEAST_GAP * dhat
    apart = place - centre
    if wp.length_sq(apart) < least * least:
        place = centre + least * wp.normalize(apart)
    places[env, node] = place


@wp.kernel
def _lean_kernel(
    nodes: wp.array(dtype=wp.int32),
    pushes: wp.array2d(dtype=wp.vec3d),
    targets: wp.array2d(dtype=wp.transformd),
    radius: wp.float64,
    bodies: wp.vec2i,
    surface: ContactSurface,
    places: wp.array2d(dtype=wp.vec3d),
):
    """Puts nodes within the range of a ball to the gap at which contact bears ``pushes``, slopes of
    the elastic energy [N]."""
    env, i = wp.tid()
    node = nodes[i]
    centre = wp.transform_get_translation(targets[env, 0])
    apart = places[env, node] - centre
    if wp.length_sq(apart) >= (radius + surface.dhat) * (radius + surface.dhat):
        return
    away = wp.normalize(apart)
    area = surface.node_areas[env % surface.node_areas.shape[0], node]
    pressure = wp.dot(pushes[env, node], away) / (
        area * pair_kappa(env, bodies[0], bodies[1], surface)
    )
    places[env, node] = centre + (radius + surface.dhat * unit_gap(pressure)) * away


def _heights_over(points: np.ndarray, face: np.ndarray) -> np.ndarray:
    """Height of a face straight over or under points [m], [n, 3], by points on it, [m, 3]; beside
    it that of the nearest of these."""
    if np.ptp(face[:, 2]) == 0.0:
        return np.full(len(points), face[0, 2])
    from scipy.interpolate import LinearNDInterpolator, NearestNDInterpolator

    over = LinearNDInterpolator(face[:, :2], face[:, 2])(points[:, :2])
    beside = np.isnan(over)
    over[beside] = NearestNDInterpolator(face[:, :2], face[:, 2])(points[beside, :2])
    return over


class WayAhead:
    """Way ahead of a gel whose environments share a rest shape, under a ball that goes along z."""

    def __init__(
        self,
        solver: SolverIPC,
        contact: np.ndarray,
        touch_m: np.ndarray,
        radius_m: float,
    ) -> None:
        """
        Args:
            solver: Of the gel and the ball, its only kinematic body.
            contact: Faces of the gel that the ball may touch, [face, 3].
            touch_m: Height of the ball's centre at first touch [m], [env_count].
            radius_m: Of the ball [m].
        """
        model = solver.model
        rest = model.rest_positions.numpy()[0, : model.soft_count]
        nodes = np.unique(contact)
        tops, low = _heights_over(rest, rest[nodes]), rest[:, 2].min()
        shares = np.clip((rest[:, 2] - low) / np.maximum(tops - low, 1e-9), 0.0, 1.0)
        device = model.device
        self._solver, self._radius = solver, radius_m
        self._nodes = wp.array(nodes, dtype=wp.int32, device=device)
        self._pushes = wp.zeros((model.env_count, model.node_count), dtype=wp.vec3d, device=device)
        self._all = wp.full(model.env_count, 1, dtype=wp.int32, device=device)
        self._tops = wp.array(tops, dtype=wp.float64, device=device)
        self._shares = wp.array(shares, dtype=wp.float64, device=device)
        self._touches = wp.array(touch_m, dtype=wp.float64, device=device)

    def write(self, state: State, target_poses: np.ndarray, places: wp.array) -> None:
        """Write where the nodes of the gel may be with the balls at poses, [env_count, 1, 7], after
        a state; to the first of ``places`` [m], vec3d, [env_count, node_count]. See
        ``goes_on``."""
        solver, m, radius = self._solver, self._solver.model, self._radius
        targets = wp.array(target_poses, dtype=wp.transformd, device=m.device)
        inputs = [m.rest_positions, self._tops, self._shares, state.positions, state.velocities]
        inputs += [state.poses, targets, self._touches, radius, solver.config.dhat_m, places]
        launch(_way_ahead_kernel, (m.env_count, m.soft_count), *inputs)
        self._pushes.zero_()
        for part in solver.elastic:
            part.add_gradient(self._all, places, self._pushes)
        bodies = wp.vec2i(0, len(m.bodies) - 1)
        inputs = [self._nodes, self._pushes, targets, radius, bodies, solver.collisions.surface]
        launch(_lean_kernel, (m.env_count, len(self._nodes)), *inputs, places)


def goes_on(way_m: np.ndarray, last_m: np.ndarray, depth_m: np.ndarray) -> bool:
    """True where all balls go on as they did in their last step, or do not touch yet.

    Args:
        way_m: Change of the depths in this step [m].
        last_m: In the last one [m].
        depth_m: Depths past first touch before it [m].
    """
    steady = (way_m * last_m > 0) & (np.abs(way_m) <= _FASTEST * np.abs(last_m))
    return bool(np.where(depth_m > 0, steady, way_m > 0).all())
