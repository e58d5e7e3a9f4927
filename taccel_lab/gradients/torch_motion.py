# SPDX-License-Identifier: Apache-2.0
"""A motion as one function of torch, through which losses go back.

``signals.torch_signals`` has markers and heights of where it leads.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import torch

from taccel_lab.errors import InputError
from taccel_lab.gradients.adjoint import pull_back
from taccel_lab.gradients.motion import TIGHT, GelMotion, MotionRecord
from taccel_lab.model import Model
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
        """Makes a ``GelMotion``, whose errors it raises."""
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
            InputError: Bad values or shapes, or what is no tensor.
        """
        inputs = {
            "poses": poses,
            "young_modulus_pa": young_modulus_pa,
            "poisson_ratio": poisson_ratio,
            "friction": friction,
        }
        for name, value in inputs.items():
            if value is not None or name == "poses":
                check_tensor(name, value)
        call = _Call(self.motion)
        positions, wrenches = _Moved.apply(call, *inputs.values())  # type: ignore[misc]
        return MovedGels(positions, wrenches, call.causes)


def check_tensor(name: str, value: object) -> None:
    """Raise InputError for what is no tensor."""
    if not isinstance(value, Tensor):
        raise InputError(
            f"{name} must be a torch tensor, got {type(value).__name__}: torch.as_tensor({name}) "
            "makes one"
        )


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


@dataclass
class _Call:
    """What stays with one call until its gradients are taken."""

    motion: GelMotion
    record: MotionRecord | None = None
    causes: list[str | None] = field(default_factory=list)
    """``MovedGels.causes``."""


class _Moved(torch.autograd.Function):
    @staticmethod
    def forward(
        call: _Call,
        poses: Tensor,
        young: Tensor | None,
        poisson: Tensor | None,
        friction: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        _set_parameters(call.motion.model, young, poisson, friction)
        call.record = call.motion.run(_host(poses))
        call.causes[:] = call.record.causes
        both = (call.record.positions, call.record.wrenches)
        found = [torch.as_tensor(value, device=poses.device) for value in both]
        return found[0], found[1]

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        del output
        ctx.call = inputs[0]
        ctx.kinds = [None if v is None else (v.device, v.dtype) for v in inputs[1:]]

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:
        values = _PulledBack.apply(ctx.call, *grads)
        back = [
            None if kind is None else value.to(*kind)
            for kind, value in zip(ctx.kinds, values, strict=True)  # type: ignore[arg-type]
        ]
        return (None, *back)


class _PulledBack(torch.autograd.Function):
    """``pull_back`` by poses, moduli and friction: a function of its own, as ``torch.func`` asks of
    one that leaves torch, which maps it over the rows of a Jacobian."""

    @staticmethod
    def forward(call: _Call, by_positions: Tensor, by_wrenches: Tensor) -> tuple[Tensor, ...]:
        assert call.record is not None
        found = pull_back(call.motion, call.record, _host(by_positions), _host(by_wrenches))
        call.causes[:] = found.causes
        pairs = np.triu(found.friction).sum(axis=(1, 2))
        values = (found.poses, found.young_modulus, found.poisson_ratio, pairs)
        return tuple(torch.as_tensor(value) for value in values)

    @staticmethod
    def setup_context(ctx: Any, inputs: Any, output: Any) -> None:
        """Nothing is kept: there is no way further back."""

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Any, ...]:
        raise InputError("a motion has first derivatives only: leave create_graph at False")

    @staticmethod
    def vmap(
        info: Any, in_dims: tuple[int | None, ...], call: _Call, *grads: Tensor
    ) -> tuple[tuple[Tensor, ...], tuple[int, ...]]:
        rows = []
        for i in range(info.batch_size):
            one = [
                value if dim is None else value.select(dim, i)
                for value, dim in zip(grads, in_dims[1:], strict=True)
            ]
            rows.append(_PulledBack.apply(call, *one))
        columns = tuple(torch.stack(column) for column in zip(*rows, strict=True))
        return columns, (0,) * len(columns)
