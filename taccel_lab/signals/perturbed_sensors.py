# SPDX-License-Identifier: Apache-2.0
"""Images, or maps of taxels, as the sensors of a ``Perturbation`` would give them: on the device.

All of it is made pixel by pixel, in the order in which a sensor does: faults of the light, light
that strays between neighbours, the gel's lag, the gain of each pixel, the camera's gain and drift,
noise, pixels that are dead, and faults of frames on their way.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import warp as wp

from taccel_lab.errors import InputError
from taccel_lab.signals.faulty_frames import RGB, FaultyFrames
from taccel_lab.signals.frame_operators import LABEL, drifted, part_across
from taccel_lab.signals.perturbation import Perturbation

BLUR_SIGMAS = 3.0
"""Reach of crosstalk."""


@wp.kernel
def _blur_line_kernel(
    values: wp.array4d(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    along_row: bool,
    blurred: wp.array4d(dtype=wp.float32),
):
    """Weighted mean along rows or columns; at the border, of the pixels that there are."""
    env, v, u, c = wp.tid()
    reach = weights.shape[0] // 2
    total, weight = float(0.0), float(0.0)
    for k in range(weights.shape[0]):
        at_u, at_v = u, v
        if along_row:
            at_u = u + k - reach
        else:
            at_v = v + k - reach
        if at_u >= 0 and at_v >= 0 and at_u < values.shape[2] and at_v < values.shape[1]:
            total += weights[k] * values[env, at_v, at_u, c]
            weight += weights[k]
    blurred[env, v, u, c] = total / weight


@wp.struct
class _Shared:
    """What all sensors have alike."""

    crosstalk: wp.float32
    lag: wp.float32
    """Hysteresis: part of a change that is added at once."""
    kept: wp.float32
    """Part of the gel's memory that is left after a step."""
    pixel_gain: wp.float32
    noise: wp.float32
    dead_share: wp.float32
    dead_low: wp.float32
    dead_high: wp.float32
    low: wp.float32
    high: wp.float32
    noise_seed: wp.int32


@wp.kernel
def _perturb_images_kernel(
    values: wp.array4d(dtype=wp.float32),
    strayed: wp.array4d(dtype=wp.float32),
    shared: _Shared,
    seeds: wp.array(dtype=wp.int32),
    gain: wp.array2d(dtype=wp.float32),
    shift: wp.array2d(dtype=wp.float32),
    gradient: wp.array3d(dtype=wp.float32),
    fresh: wp.array(dtype=wp.int32),
    memory: wp.array4d(dtype=wp.float32),
    seen: wp.array4d(dtype=wp.float32),
):
    env, v, u, c = wp.tid()
    height, width, channels = values.shape[1], values.shape[2], values.shape[3]
    pixel = (v * width + u) * channels + c
    across, down = part_across(u, width), part_across(v, height)
    level = values[env, v, u, c]
    if shared.crosstalk > 0.0:
        level += shared.crosstalk * (strayed[env, v, u, c] - level)
    if shared.lag > 0.0:
        last = memory[env, v, u, c]
        if fresh[env] == 1:
            last = level
        memory[env, v, u, c] = shared.kept * last + (1.0 - shared.kept) * level
        level += shared.lag * (level - memory[env, v, u, c])
    # The same at each call: what a pixel is, not what happens to it.
    state = wp.rand_init(seeds[env], pixel)
    own = wp.randn(state)
    if shared.pixel_gain > 0.0:
        level *= wp.max(1.0 + shared.pixel_gain * own, 0.0)
    level = drifted(
        level, gain[env, c], shift[env, c], gradient[env, 0, c], gradient[env, 1, c], across, down
    )
    if shared.noise > 0.0:
        level += shared.noise * wp.randn(wp.rand_init(shared.noise_seed + seeds[env], pixel))
    # All channels of a dead pixel are dead.
    whole = wp.rand_init(seeds[env] + 1, v * width + u)
    if wp.randf(whole) < shared.dead_share:
        level = wp.randf(whole, shared.dead_low, shared.dead_high + 1.0e-6)
    seen[env, v, u, c] = wp.clamp(level, shared.low, shared.high)


class PerturbedSensors:
    """The sensors of a ``Perturbation``, one an environment, with their gels' memory."""

    def __init__(self, drawn: Perturbation) -> None:
        self.drawn = drawn
        self._fresh = np.ones(drawn.env_count, dtype=np.int32)
        self._memory: wp.array | None = None
        self._frames: FaultyFrames | None = None
        self._turns = np.zeros((2, drawn.env_count), dtype=np.int32)
        """How often each gel was reset, and the number of its next image since."""
        self._constants: dict[tuple[str, int], list[wp.array]] = {}

    def reset(self, envs: np.ndarray | None = None) -> None:
        """Let gels forget what pressed them, and cameras their frames; ``envs``, bool, shape
        [env_count], or all."""
        who = slice(None) if envs is None else np.asarray(envs, dtype=bool)
        self._fresh[who] = 1
        self._turns[0, who] += 1
        self._turns[1, who] = 0

    def labels(self) -> np.ndarray:
        """What is wrong with the frames of the last images, see ``FaultyFrames.labels``; nothing
        where none can be."""
        if self._frames is None:
            return np.zeros(self.drawn.env_count, dtype=LABEL)
        return self._frames.labels()

    def apply(
        self, images: Any, rng: np.random.Generator | None = None, *, step_s: float | None = None
    ) -> Any:
        """What these sensors give where flawless ones give ``images``.

        Args:
            images: RGB levels 0 to 255, shape [env_count, height, width, 3], or any values of
                taxels, [env_count, rows, columns, channels]: a numpy array, a torch tensor or an
                array of Warp, on any device.
            rng: For the noise; none is added without it.
            step_s: Time since the last call [s], which hysteresis needs.

        Returns:
            The same kind of array, float32, on the same device; images are clipped to 0..255.

        Raises:
            InputError: Another shape, no time for hysteresis.
        """
        shape, faults = tuple(images.shape), self.drawn.faults
        if len(shape) != 4 or shape[0] != self.drawn.env_count:
            raise InputError(
                f"images have shape {list(shape)}; [{self.drawn.env_count}, height, width, "
                "channels] is needed"
            )
        if faults.hysteresis > 0 and not (step_s is not None and step_s > 0):
            raise InputError("hysteresis needs step_s, the time since the last call, above 0")
        values = _on_device(images)
        device = values.device
        frames = self._faulty(shape, device)
        values = values if frames is None else frames.lit(values)
        strayed = self._blurred(values) if faults.crosstalk > 0 else values
        memory = values
        if faults.hysteresis > 0:
            if self._memory is None or self._memory.shape != shape:
                self._memory = wp.zeros(shape, dtype=wp.float32, device=device)
                self._fresh[:] = 1
            memory = self._memory
        shared = self._shared(shape[3], rng, step_s)
        seen = wp.empty(shape, dtype=wp.float32, device=device)
        constants = self._of(str(device), shape[3])
        fresh = wp.array(self._fresh, dtype=wp.int32, device=device)
        wp.launch(
            _perturb_images_kernel,
            shape,
            [values, strayed, shared, *constants, fresh],
            [memory, seen],
            device=device,
        )
        self._fresh[:] = 0
        return _as_given(seen if frames is None else frames.sent(seen), images)

    def _faulty(self, shape: tuple[int, ...], device: wp.Device) -> FaultyFrames | None:
        """Faults of the frames that are given; None for none, and for taxels."""
        drawn = self.drawn
        if shape[3] != RGB or not drawn.frame_faults:
            return None
        if self._frames is None or (self._frames.shape, self._frames.device) != (shape, device):
            size = (shape[2], shape[1])
            self._frames = FaultyFrames(drawn.frame_faults, size, shape[0], device=device)
        self._frames.draw(*(
            wp.array(row, dtype=wp.int32, device=device) for row in (drawn.seeds, *self._turns)
        ))  # fmt: skip
        self._turns[1] += 1
        return self._frames

    def _shared(self, channels: int, rng: np.random.Generator | None, step_s: float | None) -> Any:
        faults, shared = self.drawn.faults, _Shared()
        shared.crosstalk, shared.lag = faults.crosstalk, faults.hysteresis
        shared.kept = math.exp(-(step_s or 0.0) / faults.hysteresis_s)
        shared.pixel_gain, shared.dead_share = faults.pixel_gain, faults.dead_share
        shared.dead_low, shared.dead_high = faults.dead_range
        images = channels == RGB
        shared.low, shared.high = (0.0, 255.0) if images else (-math.inf, math.inf)
        shared.noise = 0.0
        if rng is not None and images:
            shared.noise, shared.noise_seed = self.drawn.noise_levels, int(rng.integers(2**30))
        return shared

    def _of(self, device: str, channels: int) -> list[wp.array]:
        """What differs between sensors, on a device; taxels have neither light nor camera."""
        key = device, channels
        if key not in self._constants:
            drawn, count = self.drawn, self.drawn.env_count
            # gain * image + the rest, so that a nominal draw changes nothing, to the last bit.
            shift = drawn.offset + (1 - drawn.gain) * drawn.pivot
            tables = [drawn.gain, shift, drawn.gradient]
            if channels != RGB:
                ones, zeros = np.ones((count, channels)), np.zeros((count, channels))
                tables = [ones, zeros, np.zeros((count, 2, channels))]
            self._constants[key] = [
                wp.array(drawn.seeds, dtype=wp.int32, device=device),
                *(wp.array(t.astype(np.float32), dtype=wp.float32, device=device) for t in tables),
            ]
        return self._constants[key]

    def _blurred(self, values: wp.array) -> wp.array:
        sigma = self.drawn.faults.crosstalk_px
        steps = np.arange(-math.ceil(BLUR_SIGMAS * sigma), math.ceil(BLUR_SIGMAS * sigma) + 1)
        weights = wp.array(
            np.exp(-0.5 * (steps / sigma) ** 2).astype(np.float32), device=values.device
        )
        for along_row in (True, False):
            out = wp.empty_like(values)
            wp.launch(
                _blur_line_kernel, values.shape, [values, weights, along_row], [out],
                device=values.device,
            )  # fmt: skip
            values = out
        return values


def _on_device(images: Any) -> wp.array:
    """The values as an array of Warp, where they are."""
    if isinstance(images, wp.array):
        return images if images.dtype == wp.float32 else wp.array(images, dtype=wp.float32)
    if isinstance(images, np.ndarray):
        return wp.array(images.astype(np.float32, copy=False), dtype=wp.float32, device="cpu")
    import torch

    return wp.from_torch(images.detach().to(torch.float32).contiguous(), dtype=wp.float32)


def _as_given(seen: wp.array, images: Any) -> Any:
    if isinstance(images, wp.array):
        return seen
    return seen.numpy() if isinstance(images, np.ndarray) else wp.to_torch(seen)
