# SPDX-License-Identifier: Apache-2.0
"""Fit the inverse model: an ensemble whose members each leave out a share of the presses.

Member k of K does not see every K-th press, starting from k. Those presses stop it early, tell how
large its errors really are (the members' own expectation is scaled to them), and give a figure for
every press by a network that never saw it, at the price of a single fit.

The loss is the likelihood of normal errors of the slope, with a standard deviation that the network
gives itself (M. Seitzer et al., On the pitfalls of heteroscedastic uncertainty estimation, ICLR
2022: weighted by its square root). Heights are sums of slopes, so that it is the mean slope of all
that looks alike which has to be right: least absolute errors of the angle give the median, which
reads blurred walls too flat.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from taccel_lab.calibration.normals.options import RIM_RADII, InverseFitOptions
from taccel_lab.calibration.normals.samples import (
    KnownPress,
    NormalSamples,
    circle_angle_rad,
    samples_of_presses,
)
from taccel_lab.calibration.normals.synthetic_presses import synthetic_samples
from taccel_lab.calibration.press_options import UNTOUCHED_RADII
from taccel_lab.calibration.response.frame import CaptureScene, PressFrame
from taccel_lab.calibration.response.training import (
    arrays_of,
    descend,
    initial_weights,
    one_thread,
    trainable,
)
from taccel_lab.errors import InputError
from taccel_lab.networks.normal_settings import NormalModelConfig
from taccel_lab.progress import Progress, silent
from taccel_lab.reading.network_answers import tilt_and_error
from taccel_lab.reading.slopes import MAX_TILT_RAD, RAYLEIGH_MEAN, NormalModel
from taccel_lab.signals.tensors import layer_tensors

TASK = "fitting the inverse model"
TASK_AGAIN = "fitting it to the held-out presses, too"
CHECK_EVERY = 100
"""Steps between looks at the presses that are left out of a member."""
CHECK_PIXELS = 1500
"""Pixels of each left-out press that decide when to stop."""
STEEPEST_SLOPE = 6.0
"""Slopes are cut here, at 80 degrees: beyond, a step of the network's output has no bound."""
BETA = 0.5
"""How far large expected errors keep their weight in the loss; 0 is the likelihood itself, which
gives up on what is hard, 1 least squares, which lets the hardest pixels rule."""
AGAIN_STEPS = 30
"""Steps of a fit that goes on from another, of a hundred of the first."""
AGAIN_RATE = 0.5
"""Its learning rate against the first one's."""
WARM_UP = 0.15
"""Share of the steps in which the learning rate rises."""


@dataclass(frozen=True)
class InverseFit:
    """A fitted inverse model with what is known about its quality."""

    model: NormalModel
    left_out_deg: dict[str, float]
    """Mean angle of error inside the contact of each training press by a member that did not see
    it [degrees]; empty with one press."""
    curve: list[tuple[int, float, float]]
    """(step, training loss, error on left-out presses), both in degrees."""
    stopped_at: tuple[int, ...]
    """Step whose weights each member keeps."""
    options: InverseFitOptions
    seconds: float
    inputs: dict[str, str]
    """SHA-256 of the presses' images by name."""


def default_scales_px(frames: Sequence[PressFrame]) -> tuple[float, ...]:
    """The pixel itself, and windows of a fortieth to a fifth of the mean contact radius [px].

    Edges need the smallest; the widest is well inside a contact, so that a window at the rim does
    not average over the whole of it.
    """
    radius = float(np.mean([frame.circle.radius_px for frame in frames]))
    windows = (round(max(0.7, radius / part), 2) for part in (40.0, 20.0, 10.0, 5.0))
    return (0.0, *sorted(set(windows)))


def fold_of(index: int, members: int, frame_count: int) -> int | None:
    """Member that leaves press ``index`` out; None with too few presses or a single member."""
    return index % members if frame_count > members > 1 else None


class InverseTraining:
    """Pixels of presses and the networks that are fitted to them; begins with random ones.

    Deterministic for a seed on one thread.
    """

    def __init__(
        self,
        frames: Sequence[PressFrame],
        scene: CaptureScene,
        options: InverseFitOptions,
        synthetic_presses: Iterable[KnownPress] = (),
    ) -> None:
        if not frames:
            raise InputError("the fit of the inverse model needs at least one press")
        self.started = time.perf_counter()
        self.scene, self.options, self.known = scene, options, len(frames)
        self.frames: list[PressFrame] = []
        self.checks: list[NormalSamples] = []
        self.circles_rad: list[np.ndarray] = []
        self.pixels: list[np.ndarray] = []
        scales = default_scales_px(frames)
        config = NormalModelConfig(
            scene.grid.width_px,
            scene.grid.height_px,
            scales_px=scales,
            slope_scales_px=scales[1:],
            members=options.members,
            hidden=options.hidden,
            position_bands=options.position_bands,
        )
        rng = np.random.default_rng(options.seed)
        samples = self._drawn(frames, config, rng)
        pixels = options.synthetic_pixels
        synthetic = synthetic_samples(synthetic_presses, scene, config, pixels, rng)
        whole = NormalSamples.join([*samples, *synthetic])
        scale = np.maximum(whole.features.std(axis=0, dtype=np.float64), 1e-3)
        self.config = config = replace(
            config,
            input_mean=tuple(float(x) for x in whole.features.mean(axis=0)),
            input_scale=tuple(float(x) for x in scale),
        )
        self.synthetic = range(sum(len(part.features) for part in samples), len(whole.features))
        self.inputs = torch.from_numpy(config.normalise(whole.features))
        self.normals = torch.from_numpy(whole.normals)
        still = config.normalise(config.at_rest(whole.features[:1]))[0]
        self.still = torch.from_numpy(still[: config.varying_count])
        self._take(frames, samples, 0, rng)
        self.generator = torch.Generator().manual_seed(options.seed)
        self.shapes = config.weight_shapes()
        weights = initial_weights(self.shapes, self.generator)
        self.layers = trainable(layer_tensors(weights))

    def _drawn(
        self, frames: Sequence[PressFrame], config: NormalModelConfig, rng: np.random.Generator
    ) -> list[NormalSamples]:
        rings, zooms = self.options.rings, self.options.zooms
        return samples_of_presses(frames, self.scene, config, rings, rng, zooms)

    def _take(
        self,
        frames: Sequence[PressFrame],
        samples: Sequence[NormalSamples],
        first: int,
        rng: np.random.Generator,
    ) -> None:
        """Say where the pixels of more presses lie, from ``first`` on, and who leaves out which."""
        ends = first + np.cumsum([0, *(len(part.features) for part in samples)])
        self.pixels += [np.arange(*ends[i : i + 2]) for i in range(len(samples))]
        # Inside the contact at the picture's own zoom, and a pixel of the far field.
        rings = [(0.0, RIM_RADII, CHECK_PIXELS), (UNTOUCHED_RADII, math.inf, 1)]
        checked = samples_of_presses(frames, self.scene, self.config, rings, rng)
        for frame, found in zip(frames, checked, strict=True):
            check = NormalSamples(found.features[:-1], found.normals[:-1])
            self.checks.append(check)
            self.circles_rad.append(circle_angle_rad(frame, self.scene, check.normals))
        self.frames += frames
        members, count = self.options.members, len(self.frames)
        # As with the first presses alone: a member that had seen all of them leaves none out.
        self.folds = [fold_of(i, members, self.known) for i in range(count)]
        self.pools = [
            torch.from_numpy(
                np.concatenate([self.pixels[i] for i in range(count) if self.folds[i] != k])
            )
            for k in range(members)
        ]

    def go_on(self, frames: Sequence[PressFrame], progress: Progress = silent) -> InverseFit:
        """A shorter fit from the best weights so far, to more presses besides those before.

        Presses that a member left out stay left out of it: what it says of them stays true.
        """
        self.started = time.perf_counter()
        rng = np.random.default_rng(self.options.seed)
        more = self._drawn(frames, self.config, rng)
        new, first = NormalSamples.join(more), len(self.inputs)
        inputs = torch.from_numpy(self.config.normalise(new.features))
        self.inputs = torch.cat([self.inputs, inputs])
        self.normals = torch.cat([self.normals, torch.from_numpy(new.normals)])
        self._take(frames, more, first, rng)
        self.options = replace(
            self.options,
            steps=max(1, self.options.steps * AGAIN_STEPS // 100),
            learning_rate=AGAIN_RATE * self.options.learning_rate,
        )
        return self.run(progress, TASK_AGAIN)

    def run(self, progress: Progress = silent, task: str = TASK) -> InverseFit:
        """Train as ``options`` say."""
        with one_thread():
            self._descend(progress, task)
            model, left_out = self._finish()
        return InverseFit(
            model=model,
            left_out_deg=left_out,
            curve=self.curve,
            stopped_at=tuple(int(step) for step in self.best_step),
            options=self.options,
            seconds=time.perf_counter() - self.started,
            inputs={frame.name: frame.sha256 for frame in self.frames},
        )

    def _descend(self, progress: Progress, task: str) -> None:
        options = self.options
        self.curve: list[tuple[int, float, float]] = []
        self.best_error = np.full(options.members, np.inf)
        self.best_step = np.zeros(options.members, dtype=int)
        self.best = [(w.detach().clone(), b.detach().clone()) for w, b in self.layers]
        self._keep_best(0)
        tilt = wanted = torch.empty(0)

        def loss() -> torch.Tensor:
            nonlocal tilt, wanted
            batch = torch.stack([self._draw(pool) for pool in self.pools])
            inputs = self.inputs[batch]
            still = inputs.clone()
            still[..., : len(self.still)] = self.still
            tilt, error = tilt_and_error(self.layers, inputs, still)
            wanted = self.normals[batch]
            return slope_loss(tilt, error, wanted)

        def after_step(step: int, _: torch.Tensor) -> None:
            if step % CHECK_EVERY == 0 or step == options.steps:
                train_deg = float(np.degrees(chord_of(tilt.detach(), wanted).mean().item()))
                self.curve.append((step, train_deg, self._keep_best(step)))
                progress(task, step, options.steps)

        descend(
            self.layers, loss, after_step,
            steps=options.steps, learning_rate=options.learning_rate, warm_up=WARM_UP,
            # Windows of one pixel say nearly the same: Muon learns their differences as fast.
            matrices=[weight for weight, _ in self.layers[:-1]],
        )  # fmt: skip

    def _draw(self, pool: torch.Tensor) -> torch.Tensor:
        """Indices of a member's next pixels."""
        count = self.options.batch_pixels
        synthetic = round(self.options.synthetic_share * count) if self.synthetic else 0
        drawn = pool[torch.randint(len(pool), (count - synthetic,), generator=self.generator)]
        if not synthetic:
            return drawn
        more = torch.randint(len(self.synthetic), (synthetic,), generator=self.generator)
        return torch.cat([drawn, self.synthetic.stop - 1 - more])

    def _keep_best(self, step: int) -> float:
        """Keep the weights of each member that does better than ever on what it leaves out; the
        mean error on that [degrees]."""
        angles = [self._angles(i)[0] for i in range(len(self.checks))]
        means = []
        for k in range(self.options.members):
            own = [a for i, a in enumerate(angles) if self.folds[i] == k]
            error = float(np.mean(np.concatenate(own))) if own else -float(step)
            if error < self.best_error[k]:
                self.best_error[k], self.best_step[k] = error, step
                for kept, layer in zip(self.best, self.layers, strict=True):
                    for target, tensor in zip(kept, layer, strict=True):
                        target[k] = tensor.detach()[k]
            means += [error] if own else []
        return float(np.degrees(np.mean(means))) if means else float("nan")

    def _outputs(self, fold: int, samples: NormalSamples) -> tuple[torch.Tensor, torch.Tensor]:
        """Tilt and expected error of one member; of all members for a negative ``fold``."""
        part = slice(fold, fold + 1) if fold >= 0 else slice(None)
        layers = [(weight[part], bias[part]) for weight, bias in self.layers]
        inputs, still = (
            torch.from_numpy(self.config.normalise(x)).expand(len(layers[0][0]), -1, -1)
            for x in (samples.features, self.config.at_rest(samples.features))
        )
        with torch.no_grad():
            return tilt_and_error(layers, inputs, still)

    def _angles(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        """Errors and expected errors [rad] on press ``index`` by the member that leaves it out."""
        fold, samples = self.folds[index], self.checks[index]
        if fold is None:
            return np.empty(0), np.empty(0)
        tilt, error = self._outputs(fold, samples)
        chord = chord_of(tilt, torch.from_numpy(samples.normals)[None])[0].numpy()
        return 2 * np.arcsin(np.clip(chord / 2, 0, 1)), error[0].numpy()

    def _finish(self) -> tuple[NormalModel, dict[str, float]]:
        """The model with the best weights, its expected error scaled to the left-out presses."""
        with torch.no_grad():
            for kept, layer in zip(self.best, self.layers, strict=True):
                for target, tensor in zip(kept, layer, strict=True):
                    tensor.copy_(target)
        left_out, seen, expected, spreads = {}, [], [], []
        everyone = range(self.options.members)
        for i, frame in enumerate(self.frames):
            angle, own = self._angles(i)
            if len(angle):
                left_out[frame.name] = float(np.degrees(angle.mean()))
                tilts = self._outputs(-1, self.checks[i])[0]
                others = tilts[[k for k in everyone if k != self.folds[i]]]
                spread2 = (others - others.mean(dim=0)).square().sum(dim=-1).mean(dim=0)
                seen.append(angle)
                expected.append(own)
                spreads.append(spread2.numpy() + (RAYLEIGH_MEAN * self.circles_rad[i]) ** 2)
        factor = 1.0
        if seen:
            factor = _error_factor(*(np.concatenate(x) for x in (seen, expected, spreads)))
        arrays = arrays_of(self.shapes, self.layers)
        return NormalModel(replace(self.config, error_factor=factor), arrays), left_out


def _error_factor(seen: np.ndarray, expected: np.ndarray, other2: np.ndarray) -> float:
    """Factor on the members' expected errors [rad] that makes those on left-out presses true.

    A press's error is ``sqrt((factor expected)^2 + other^2)``, ``other`` being the disagreement of
    the members that saw it and what its circle is off by. The one that did not see it has no part
    in that: its error would stand on both sides. It errs more than the ensemble, so that the factor
    is rather too large.
    """
    wanted = max(seen.mean() ** 2 - other2.mean(), (0.5 * seen.mean()) ** 2)
    return float(np.sqrt(wanted) / expected.mean())


def lean_of_tilt(tilt: torch.Tensor) -> torch.Tensor:
    """How far a normal leans for its height, minus the slope, of a tilt [rad]; same shape."""
    angle = (tilt.square().sum(dim=-1, keepdim=True) + 1e-16).sqrt()
    return tilt / angle * angle.clamp_max(math.atan(STEEPEST_SLOPE)).tan()


def slope_loss(tilt: torch.Tensor, error: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """Loss of tilts [..., 2] and expected errors [...] [rad] against true normals [..., 3]."""
    lean = lean_of_tilt(tilt)
    upright = normals[..., 2:].clamp_min(1.0 / math.hypot(1.0, STEEPEST_SLOPE))
    away2 = (lean - normals[..., :2] / upright).square().sum(dim=-1)
    # An angle's error grows with 1 + slope^2 where it becomes one of the slope.
    sigma2 = (error / RAYLEIGH_MEAN * (1.0 + lean.detach().square().sum(dim=-1))).square()
    return (sigma2.detach() ** BETA * (0.5 * away2 / sigma2 + sigma2.log())).mean()


def chord_of(tilt: torch.Tensor, normals: torch.Tensor) -> torch.Tensor:
    """Length of the difference of the normal that a tilt [..., 2] gives and a true one [..., 3]."""
    angle = (tilt.square().sum(dim=-1, keepdim=True) + 1e-16).sqrt()
    cut = angle.clamp_max(MAX_TILT_RAD)
    given = torch.cat([tilt / angle * cut.sin(), cut.cos()], dim=-1)
    return ((given - normals).square().sum(dim=-1) + 1e-16).sqrt()
