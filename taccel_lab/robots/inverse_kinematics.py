# SPDX-License-Identifier: Apache-2.0
"""Joint coordinates that bring a link to a pose: batched damped least squares with limits.

Levenberg-Marquardt on the pose's error, position [m] and rotation vector [rad] times a length of
the robot, with its own damping for each environment [Wampler 1986; Sugihara 2011]. A joint at
a limit that would be pushed beyond it is left out of the step. An attempt that ends elsewhere, in
a local minimum, is followed by others from random coordinates.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from taccel_lab.guards import require_positive, require_range
from taccel_lab.robots.kinematics import Kinematics
from taccel_lab.robots.transforms import rotation_vector


@dataclass(frozen=True)
class IKOptions:
    """How inverse kinematics is solved, and when a link has arrived."""

    position_tolerance_m: float = 1e-7
    rotation_tolerance_rad: float = 1e-6
    position_only: bool = False
    """Whether the link's origin alone is to arrive, turned as it likes: for fingers of few joints.
    """
    attempts: int = 50
    """The first from the given start, the others from random coordinates."""
    iterations: int = 100
    """Most steps of an attempt."""
    seed: int = 0
    """Seed of the random coordinates."""

    def __post_init__(self) -> None:
        for name in ("position_tolerance_m", "rotation_tolerance_rad"):
            require_positive(name, getattr(self, name))
        for name in ("attempts", "iterations"):
            require_range(name, getattr(self, name), 1, math.inf)


@dataclass(frozen=True)
class IKResult:
    """What inverse kinematics found, by environment."""

    q: np.ndarray
    """Coordinates [rad or m], [n, dof]: of what arrived, else the closest that was found."""
    arrived: np.ndarray
    """Whether the link is at its pose within the tolerances, bool, [n]."""
    position_error_m: np.ndarray
    """Distance left, [n]."""
    rotation_error_rad: np.ndarray
    """Angle left, [n]; not counted where the position alone is requested."""
    attempts: np.ndarray
    """Starts that were tried, int, [n]."""


_SMALLEST_DAMPING, _LARGEST_DAMPING = 1e-12, 1e8
_FIRST_DAMPING = 1.0
"""Damping over the mean square of the Jacobian's columns. Long first steps end in other minima
more often."""
_STALLED = 1e-3
"""Part by which the squared error has to fall in ``_PATIENCE`` steps to go on."""
_PATIENCE = 8


class _Problem:
    """The poses that a link is to reach."""

    def __init__(
        self, tree: Kinematics, link: str, targets: np.ndarray, options: IKOptions
    ) -> None:
        """``targets``: base_from_link, [n, 4, 4]."""
        self.tree, self.link, self.targets, self.options = tree, link, targets, options
        self.length = max(tree.length_m(link), 1e-3) / 3
        """Weight of an angle [m/rad]: about the arm on which half of the joints move the link."""

    def errors(self, q: np.ndarray, who: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What is missing: [n, 6] in metres and radians; and ``Kinematics.along`` at q."""
        frames = self.tree.along(self.link, q)
        at, wanted = frames[:, -1], self.targets[who]
        turn = rotation_vector(wanted[:, :3, :3] @ at[:, :3, :3].transpose(0, 2, 1))
        return np.concatenate([wanted[:, :3, 3] - at[:, :3, 3], turn], axis=1), frames

    def weighted(self, error: np.ndarray) -> np.ndarray:
        """Errors or columns of the Jacobian, [n, 6, ...], as what is minimised [m]."""
        weight = np.full(6, 0.0 if self.options.position_only else self.length)
        weight[:3] = 1.0
        return error * weight.reshape(1, 6, *[1] * (error.ndim - 2))

    def cost(self, error: np.ndarray) -> np.ndarray:
        """Squared errors [m^2] of [n, 6], shape [n]."""
        return np.sum(self.weighted(error) ** 2, axis=1)

    def arrived(self, error: np.ndarray) -> np.ndarray:
        """Whether errors [n, 6] are within the tolerances, bool, [n]."""
        near = np.linalg.norm(error[:, :3], axis=1) <= self.options.position_tolerance_m
        if self.options.position_only:
            return near
        return near & (np.linalg.norm(error[:, 3:], axis=1) <= self.options.rotation_tolerance_rad)


def solve(
    tree: Kinematics, link: str, targets: np.ndarray, start: np.ndarray, options: IKOptions
) -> IKResult:
    """Coordinates for base_from_link ``targets`` [n, 4, 4], from ``start`` [n, dof]."""
    problem = _Problem(tree, link, targets, options)
    random = np.random.default_rng(options.seed)
    low, high = _finite(tree.limits)
    best = np.clip(start, *tree.limits.T)
    everyone = np.arange(len(targets))
    best_error = problem.errors(best, everyone)[0]
    attempts = np.zeros(len(targets), dtype=np.int64)
    idle = ~tree.factors[tree.path_to(link)].any(axis=0)
    for attempt in range(options.attempts):
        who = everyone[~problem.arrived(best_error)]
        if not len(who):
            break
        begin = best[who]
        if attempt:
            # What does not move the link stays as it was.
            begin = np.where(idle, begin, random.uniform(low, high, begin.shape))
        attempts[who] += 1
        q, error = _attempt(problem, who, begin)
        better = problem.cost(error) < problem.cost(best_error[who])
        best[who[better]], best_error[who[better]] = q[better], error[better]
    return IKResult(
        best,
        problem.arrived(best_error),
        np.linalg.norm(best_error[:, :3], axis=1),
        np.linalg.norm(best_error[:, 3:], axis=1),
        attempts,
    )


def _finite(limits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Ends to draw coordinates between [dof]: of a joint without limits, a turn."""
    low = np.where(np.isfinite(limits[:, 0]), limits[:, 0], -np.pi)
    return low, np.where(np.isfinite(limits[:, 1]), limits[:, 1], low + 2 * np.pi)


def _attempt(
    problem: _Problem, who: np.ndarray, begin: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Descend from ``begin`` [n, dof] in the environments ``who`` [n]: coordinates and errors."""
    tree = problem.tree
    low, high = tree.limits.T
    q = np.clip(begin, low, high)
    error, frames = problem.errors(q, who)
    damping = np.full(len(q), _FIRST_DAMPING)
    cost = problem.cost(error)
    before = cost.copy()
    going = ~problem.arrived(error)
    for step in range(problem.options.iterations):
        if step % _PATIENCE == 0 and step:
            going &= cost < (1 - _STALLED) * before
            before = cost.copy()
        on = np.flatnonzero(going)
        if not len(on):
            break
        place = frames[on, -1, :3, 3]
        jacobian = problem.weighted(tree.jacobian(problem.link, frames[on], place))
        downhill = np.einsum("nkd,nk->nd", jacobian, problem.weighted(error[on]))
        held = ((q[on] <= low) & (downhill < 0)) | ((q[on] >= high) & (downhill > 0))
        jacobian = np.where(held[:, None], 0.0, jacobian)
        normal = np.einsum("nkd,nke->nde", jacobian, jacobian)
        scale = np.trace(normal, axis1=1, axis2=2) / normal.shape[1] + 1e-300
        normal += (damping[on] * scale)[:, None, None] * np.eye(normal.shape[1])
        downhill = np.where(held, 0.0, downhill)
        tried = np.clip(q[on] + np.linalg.solve(normal, downhill[..., None])[..., 0], low, high)
        tried_error, tried_frames = problem.errors(tried, who[on])
        tried_cost = problem.cost(tried_error)
        better = tried_cost < cost[on]
        at = on[better]
        q[at], error[at], frames[at] = tried[better], tried_error[better], tried_frames[better]
        cost[at] = tried_cost[better]
        damping[on] *= np.where(better, 0.2, 5.0)
        damping = np.clip(damping, _SMALLEST_DAMPING, None)
        going &= (damping < _LARGEST_DAMPING) & ~problem.arrived(error)
    return q, error
