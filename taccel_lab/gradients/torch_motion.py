# SPDX-License-Identifier: Apache-2.0
"""A motion as one function of torch, and pictures of where it leads, through which losses go back.

The positions of markers and the heights of a face are linear in the nodes of the face that is met,
and written here in torch. Colours are not: they are kernels without a way back (``signals``), so
that a loss of an image goes by its markers or its height map.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.geometry import PixelGrid
from taccel_lab.gradients.adjoint import pull_back
from taccel_lab.gradients.motion import TIGHT, GelMotion
from taccel_lab.model import Model
from taccel_lab.signals import MarkerLayout
from taccel_lab.signals.raster import FaceRaster
from taccel_lab.solvers import SolverConfig

Tensor = torch.Tensor


class MovedGels(NamedTuple):
    """What a motion gives; NaN in an environment from the step on that failed there."""

    positions: Tensor
    """All nodes after each step [m], float64, [step_count, env_count, node_count, 3]."""
    wrenches: Tensor
    """``MotionRecord.wrenches``, float64, [step_count, env_count, kinematic_count, 6]."""
    causes: list[str | None]
    """Why an environment has no result; after ``backward`` also, why it has no gradients, which are
    NaN then."""


class TorchMotion:
    """Motions of one model as a function of poses, moduli and friction."""

    def __init__(self, model: Model, config: SolverConfig = TIGHT) -> None:
        """As ``GelMotion``, whose errors it raises."""
        self.motion = GelMotion(model, config)

    def __call__(
        self,
        poses: Tensor,
        *,
        young_modulus_pa: Tensor | None = None,
        poisson_ratio: Tensor | None = None,
        friction: Tensor | None = None,
    ) -> MovedGels:
        """Move the tools through ``poses`` from rest.

        Args:
            poses: [step_count + 1, env_count, kinematic_count, 7], see ``MotionRecord.poses``.
            young_modulus_pa: Of each gel, [env_count, gel_count]; as they are when None.
            poisson_ratio: The same shape.
            friction: One coefficient of all pairs of bodies that may touch, [env_count].

        Raises:
            InputError: Bad values or shapes.
        """
        causes: list[str | None] = []
        inputs = (poses, young_modulus_pa, poisson_ratio, friction)
        positions, wrenches = _Moved.apply(self.motion, causes, *inputs)  # type: ignore[misc]
        return MovedGels(positions, wrenches, causes)


def _set_parameters(
    model: Model, young: Tensor | None, poisson: Tensor | None, friction: Tensor | None
) -> None:
    gels = len(model.scene.soft_bodies)
    for name, value in (("young_modulus_pa", young), ("poisson_ratio", poisson)):
        if value is None:
            continue
        if value.shape != (model.env_count, gels):
            raise InputError(
                f"{name} must have shape [{model.env_count}, {gels}], one of each gel, got "
                f"{list(value.shape)}"
            )
        for gel in range(gels):
            model.set_body(model.bodies[gel].name, **{name: _host(value)[:, gel]})
    if friction is not None:
        for first, second in model.contact_plan.pairs:
            names = (model.bodies[first].name, model.bodies[second].name)
            model.set_friction(*names, _host(friction))


def _host(value: Tensor) -> np.ndarray:
    return value.detach().cpu().numpy().astype(np.float64)


class _Moved(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        motion: GelMotion,
        causes: list[str | None],
        poses: Tensor,
        young: Tensor | None,
        poisson: Tensor | None,
        friction: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        _set_parameters(motion.model, young, poisson, friction)
        ctx.motion, ctx.record, ctx.causes = motion, motion.run(_host(poses)), causes
        ctx.like = poses, young, poisson, friction
        causes[:] = ctx.record.causes
        both = (ctx.record.positions, ctx.record.wrenches)
        found = [torch.as_tensor(value, device=poses.device) for value in both]
        return found[0], found[1]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:
        found = pull_back(ctx.motion, ctx.record, _host(grads[0]), _host(grads[1]))
        ctx.causes[:] = found.causes
        pairs = np.triu(found.friction).sum(axis=(1, 2))
        values = (found.poses, found.young_modulus, found.poisson_ratio, pairs)
        back = [
            None if like is None else torch.as_tensor(value).to(like)
            for like, value in zip(ctx.like, values, strict=True)
        ]
        return (None, None, *back)


def marker_places(positions: Tensor, layout: MarkerLayout, first_node: int = 0) -> Tensor:
    """Places of painted markers [m], [..., marker, 3], from nodes [..., node_count, 3];
    ``first_node``: of the gel."""
    nodes = torch.as_tensor(layout.nodes + first_node, dtype=torch.long, device=positions.device)
    weights = torch.as_tensor(layout.weights, device=positions.device).to(positions)
    return (positions[..., nodes, :] * weights[..., None]).sum(dim=-2)


def height_map(positions: Tensor, faces: np.ndarray, grid: PixelGrid) -> Tensor:
    """Heights of a gel's face at the pixels of a grid [m], [env, height_px, width_px], NaN where
    there is none.

    Linear between the nodes of the triangle that a pixel sees (``signals.raster``), which is taken
    as given: the height has a kink where a pixel passes from one triangle to the next.

    Args:
        positions: Nodes in the gel frame [m], float64, [env, node_count, 3].
        faces: Triangles of the face, int, [face, 3].
        grid: Pixels.
    """
    raster = FaceRaster(faces, grid)
    host = positions.detach().cpu().contiguous().to(torch.float64)
    raster.update(wp.from_torch(host, dtype=wp.vec3d))
    seen = torch.as_tensor(raster.face_at_pixel.numpy(), dtype=torch.long, device=positions.device)
    env, row, column = torch.nonzero(seen >= 0, as_tuple=True)
    corners = torch.as_tensor(np.asarray(faces), dtype=torch.long, device=positions.device)
    a, b, c = (positions[env, corners[seen[env, row, column], i]] for i in range(3))
    x_m = torch.as_tensor(grid.x_mm() * 1e-3, device=positions.device)[column]
    y_m = torch.as_tensor(grid.y_mm() * 1e-3, device=positions.device)[row]

    def area(u: Tensor, v: Tensor) -> Tensor:
        return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

    at = torch.stack([x_m, y_m], dim=1) - a[:, :2]
    whole = area(b - a, c - a)
    second, third = area(at, c - a) / whole, area(b - a, at) / whole
    height = a[:, 2] + second * (b[:, 2] - a[:, 2]) + third * (c[:, 2] - a[:, 2])
    shape = (len(positions), grid.height_px, grid.width_px)
    empty = torch.full(shape, torch.nan, dtype=positions.dtype, device=positions.device)
    return empty.index_put((env, row, column), height)
