# SPDX-License-Identifier: Apache-2.0
"""What a policy sees of a step, in torch: a tactile image of each gel and the wrench on it.

Images are those of ``SignalTactile``, 64 x 64 pixels over the gel's contact face by a colour
network of the real architecture with seeded random weights (that of the suite ``images``); wrenches
those of ``Outputs.soft_wrenches``. Torch reads both where they are, and takes the mean of each
colour of each image: nothing is copied to the host.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from taccel_lab.benchmarks.clock import clock_of
from taccel_lab.benchmarks.images import background, color_model
from taccel_lab.model import Model
from taccel_lab.outputs import to_torch
from taccel_lab.outputs.gel_frames import GelFrames
from taccel_lab.outputs.soft_wrenches import SoftWrenchReader
from taccel_lab.signals.gel_faces import bonded_gels, face_grid
from taccel_lab.signals.tactile import SignalTactile
from taccel_lab.solvers import SolverIPC
from taccel_lab.state import State

if TYPE_CHECKING:
    import torch

SIZE_PX = (64, 64)
OBSERVED = ("rgb", "wrench")
"""What there is to see."""


@dataclass
class Sight:
    """How much was seen, and what it took."""

    env_steps: int
    """Steps of environments that were looked at."""
    seconds: dict[str, float]
    """Of each kind, torch's part too."""

    @classmethod
    def none(cls, names: tuple[str, ...]) -> Sight:
        return cls(0, dict.fromkeys(names, 0.0))

    @property
    def total_s(self) -> float:
        """Of all kinds."""
        return sum(self.seconds.values())


class Observer:
    """Looks at the gels of a solver's scene: its bonded soft bodies."""

    def __init__(self, solver: SolverIPC, names: tuple[str, ...]) -> None:
        """``names``: of ``OBSERVED``.

        Raises:
            InputError: The scene has no gel.
        """
        self._model = model = solver.model
        self._clock = clock_of(model.device)
        self.gels = bonded_gels(model)
        """Indices of the gels among the soft bodies."""
        self._frames = GelFrames(model)
        self._signals = [gel_signal(model, i) for i in self.gels] if "rgb" in names else []
        self._wrenches = SoftWrenchReader(solver) if "wrench" in names else None
        self.images: list[torch.Tensor] = []
        """Latest images of each gel, uint8, [env observed, 64, 64, 3] each."""
        self.wrenches: torch.Tensor | None = None
        """Latest wrenches on the soft bodies, float64, [env observed, soft body, 6]."""
        self.features: torch.Tensor | None = None
        """What torch made of them, float32, [env observed, gel, ...]: the means of three colours, 0
        to 1, and the six entries of the wrench, in the order asked for."""
        self._names = names
        self._spent = Sight.none(names)

    def observe(self, state: State, who: np.ndarray | None = None) -> None:
        """See what the last step led to in the environments of ``who`` (bool, [env_count]), in all
        when None; waits for the device, so that each kind has its own time."""
        import torch

        count = self._model.env_count if who is None else int(np.count_nonzero(who))
        if count == 0:
            return
        self._spent.env_steps += count
        wp.synchronize_device(self._model.device)
        parts = []
        for name in self._names:
            started = self._clock()
            parts.append(self._see_images(state, who) if name == "rgb" else self._feel(state, who))
            wp.synchronize_device(self._model.device)
            self._spent.seconds[name] += self._clock() - started
        self.features = torch.cat(parts, dim=2)

    def take(self) -> Sight:
        """What was seen since this was asked last."""
        spent, self._spent = self._spent, Sight.none(self._names)
        return spent

    def _see_images(self, state: State, who: np.ndarray | None) -> torch.Tensor:
        import torch

        self.images = []
        for gel, signal in zip(self.gels, self._signals, strict=True):
            signal.update(state.positions, self._frames.of(gel, state), who)
            self.images.append(to_torch(signal.rgb))
        means = [image.to(torch.float32).mean(dim=(1, 2)) / 255.0 for image in self.images]
        return torch.stack(means, dim=1)

    def _feel(self, state: State, who: np.ndarray | None) -> torch.Tensor:
        import torch

        assert self._wrenches is not None
        self.wrenches = to_torch(self._wrenches.read(state, who))
        return self.wrenches[:, self.gels].to(torch.float32)

    def figures(self, sight: Sight, env_steps: int, seconds: float) -> dict[str, Any]:
        """For a row of results: of ``env_steps`` steps of environments that took so long."""
        found: dict[str, Any] = {"what": list(self._names), "gels": len(self.gels)}
        found |= {"env_steps": sight.env_steps, "fps": env_steps / seconds}
        found["fps_without"] = env_steps / (seconds - sight.total_s)
        for name, spent in sight.seconds.items():
            found[f"{name}_us_per_env_step"] = 1e6 * spent / sight.env_steps
        if self._signals:
            found["size_px"] = list(SIZE_PX)
            found["images_per_s"] = sight.env_steps * len(self.gels) / sight.seconds["rgb"]
        return found


def gel_signal(model: Model, body: int) -> SignalTactile:
    """Images of a soft body's contact face, which fills them; pixels need not be square."""
    mesh = model.scene.soft_bodies[body].nodal_mesh
    grid = face_grid(mesh, SIZE_PX)
    return SignalTactile(
        mesh,
        grid,
        env_count=model.env_count,
        color_model=color_model(grid),
        background_rgb=background(grid),
        first_node=model.bodies[body].node_slice.start,
        device=model.device,
    )
