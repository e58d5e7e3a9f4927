# SPDX-License-Identifier: Apache-2.0
"""Training of a force model: torch and numpy alone, on the CPU or a GPU.

The loss is the beta likelihood of Seitzer et al. (ICLR 2022) of force, moment and area, and the
squares of the patches' forces beside it. Images get the light of another day: a gain, an offset
and a gradient of each channel that the background does not have, drawn from the profile's spread.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace

import numpy as np
import torch

from taccel_lab.calibration.response.training import descend, one_thread
from taccel_lab.errors import InputError
from taccel_lab.learning.force.options import ForceOptions
from taccel_lab.learning.force.samples import ForceSamples, spread_of
from taccel_lab.learning.force.training_file import Keeper, TrainingFile, training_key
from taccel_lab.learning.scalars import Scalars, unwritten
from taccel_lab.networks.force_settings import (
    LEVELS,
    STATISTICS,
    TARGETS,
    ForceModelConfig,
)
from taccel_lab.progress import Progress, silent
from taccel_lab.signals.force_network import (
    color_reach,
    distances,
    forward,
    image_statistics,
    layer_names,
)

TASK = "training the force model"
BETA = 0.5
PATCH_WEIGHT = 0.5
WARM_UP = 0.15
EVERY = 50
"""Steps between two points of the loss curve."""
AREA_BIAS = -5.0
"""What the areas of patches start from, before their softplus."""
BATCH = 256
"""Images that are predicted at once."""
RIDGE = 1e-3
"""Ridge of the covariances, over their mean variance."""
BEYOND = 1.05
"""Largest values of the training count up to this factor."""
COMPARED = ("features.", "statistics.", "colors.")
"""Arrays that images are compared with; the others are trained."""
_OUTPUTS = {"patches_n": "patches"}


@dataclass(frozen=True)
class LightSpread:
    """How far an image's light differs from its background's; standard deviations by channel."""

    gain: tuple[float, float, float] = (0.0, 0.0, 0.0)
    pivot: tuple[float, float, float] = (0.0, 0.0, 0.0)
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gradient: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Predictions:
    """What a network tells of samples."""

    targets: np.ndarray
    """[step, 7]."""
    sigma: np.ndarray
    """Standard deviations before ``sigma_factor``, [step, 7]."""
    patches_n: np.ndarray
    """[step, 3, row, column]."""
    features: np.ndarray
    """[step, hidden]."""
    statistics: np.ndarray
    """[step, STATISTICS]."""
    colors: np.ndarray
    """``color_reach``, [step, 26]."""
    distances: np.ndarray
    """Distances of features, statistics and colours, [step, 3]; before limits."""

    @classmethod
    def of(cls, predicted: Mapping[str, np.ndarray]) -> Predictions:
        """Predictions from outputs of ``predictions_of``."""
        return cls(
            **{name: predicted[_OUTPUTS.get(name, name)] for name in cls.__dataclass_fields__}
        )


@dataclass(frozen=True)
class TrainedForces:
    """A trained network, before its limits and factors are known."""

    config: ForceModelConfig
    weights: dict[str, np.ndarray]
    curve: list[tuple[int, float]]
    """(step, loss)."""


def torch_device(name: str) -> torch.device:
    """A device that is there; InputError otherwise."""
    try:
        device = torch.device(name)
    except RuntimeError:
        raise InputError(f"no device {name!r}; cpu or cuda") from None
    if device.type not in ("cpu", "cuda"):
        raise InputError(f"a force model is trained on cpu or cuda, not on {name}")
    if device.type == "cuda" and not torch.cuda.is_available():
        raise InputError(f"{name}: torch finds no GPU here; leave --device out for the CPU")
    return device


@contextmanager
def _repeatable(device: torch.device) -> Iterator[None]:
    """One thread on the CPU, on a GPU the same kernels each time."""
    before = torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    try:
        with one_thread() if device.type == "cpu" else nullcontext():
            yield
    finally:
        torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = before


class LightDraw:
    """Draws the light of images against their background's."""

    def __init__(self, spread: LightSpread, strength: float, seed: int) -> None:
        self.spread, self.strength = spread, strength
        # On the CPU, so that a GPU sees the same lights.
        self.generator = torch.Generator().manual_seed(seed)

    def lit(self, change: torch.Tensor, rest: torch.Tensor) -> torch.Tensor:
        """Changes of colour [n, 3, h, w] with drawn lights; ``rest`` are the untouched images."""
        spread = self.spread
        if self.strength == 0 or not any((*spread.gain, *spread.offset, *spread.gradient)):
            return change
        drawn = torch.randn((len(change), 4, 3), generator=self.generator) * self.strength
        drawn = drawn.to(change.device)

        def by_channel(values: tuple[float, float, float], k: int) -> torch.Tensor:
            sigma = torch.tensor(values, device=change.device)
            return (drawn[:, k] * sigma)[:, :, None, None]

        height, width = change.shape[2:]
        u = torch.linspace(-1, 1, width, device=change.device)
        v = torch.linspace(-1, 1, height, device=change.device)[:, None]
        gain = by_channel(spread.gain, 0).clamp_min(-0.9)
        pivot = torch.tensor(spread.pivot, device=change.device)[:, None, None]
        found = change + gain * (change + rest - pivot) + by_channel(spread.offset, 1)
        found = found + by_channel(spread.gradient, 2) * u + by_channel(spread.gradient, 3) * v
        # A camera's levels end at 0 and 255.
        return (found + rest).clamp(0.0, 255.0) - rest

    def state_dict(self) -> dict[str, torch.Tensor]:
        """Where its lights are."""
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, torch.Tensor]) -> None:
        """Go on from there."""
        self.generator.set_state(state["generator"])


class _Batches:
    """Samples in a drawn order, in another one when all were drawn."""

    def __init__(self, count: int, batch: int, generator: torch.Generator) -> None:
        self.count, self.batch, self.generator = count, batch, generator
        self.order, self.used = torch.randperm(count, generator=generator), 0

    def next_rows(self) -> torch.Tensor:
        if self.used + self.batch > self.count and self.used:
            self.order, self.used = torch.randperm(self.count, generator=self.generator), 0
        rows = self.order[self.used : self.used + self.batch]
        self.used += self.batch
        return rows

    def state_dict(self) -> dict[str, torch.Tensor | int]:
        generator = self.generator.get_state()
        return {"order": self.order, "used": self.used, "generator": generator}

    def load_state_dict(self, state: dict) -> None:
        self.order, self.used = state["order"], state["used"]
        self.generator.set_state(state["generator"])


class _Loader:
    """Samples on a device."""

    def __init__(self, samples: ForceSamples, device: torch.device) -> None:
        self.count = len(samples)
        self.change = torch.from_numpy(samples.change).to(device)
        self.rest = torch.from_numpy(samples.rest).to(device)
        self.touch = torch.from_numpy(samples.touch).to(device)
        self.moved = None if samples.moved is None else torch.from_numpy(samples.moved).to(device)
        self.patches = torch.from_numpy(samples.patches_n).to(device)
        self.targets = torch.from_numpy(samples.targets).to(device)

    def images(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Changes of colour and untouched images [levels]."""
        return self.change[rows].float(), self.rest[self.touch[rows]].float()


def train_force_model(
    samples: ForceSamples,
    config: ForceModelConfig,
    centers_mm: np.ndarray,
    light: LightSpread,
    options: ForceOptions,
    progress: Progress = silent,
    kept: TrainingFile | None = None,
    scalars: Scalars = unwritten,
) -> TrainedForces:
    """Train on ``samples``; the same on the same machine for the same seed.

    ``config`` has the sizes; scales are those of the samples. A training that ``kept`` holds is
    gone on with, and ends as it would have without the interrupt; its file stays for the caller to
    remove.
    """
    device = torch_device(options.device)
    config = replace(
        config,
        patch_scale_n=spread_of(samples.patches_n.transpose(0, 2, 3, 1).reshape(-1, 3)),
        target_scale=spread_of(samples.targets),
    )
    with _repeatable(device):
        weights, curve = _train(
            samples, config, centers_mm, light, options, device, progress, kept, scalars
        )  # fmt: skip
        predicted = tell(
            samples, config, weights, centers_mm, light, options, seed=options.seed + 1
        )
    for name in ("features", "statistics"):
        values = getattr(predicted, name).astype(np.float64)
        weights[f"{name}.mean"] = values.mean(axis=0).astype(np.float32)
        weights[f"{name}.whiten"] = whitening(values).astype(np.float32)
    weights["colors.most"] = np.maximum(predicted.colors.max(axis=0), 1.0)
    shear = np.hypot(samples.targets[:, 0], samples.targets[:, 1])
    largest = (
        samples.targets[:, 2].max(), shear.max(), samples.targets[:, 6].max(),
        samples.patches_n[:, 2].max(),
    )  # fmt: skip
    most = tuple(BEYOND * max(float(value), 1e-6) for value in largest)
    return TrainedForces(replace(config, most=most), weights, curve)


def _train(
    samples: ForceSamples,
    config: ForceModelConfig,
    centers_mm: np.ndarray,
    light: LightSpread,
    options: ForceOptions,
    device: torch.device,
    progress: Progress,
    kept: TrainingFile | None,
    scalars: Scalars,
) -> tuple[dict[str, np.ndarray], list[tuple[int, float]]]:
    generator = torch.Generator().manual_seed(options.seed)
    tensors = {
        name: value.to(device).requires_grad_()
        for name, value in _initial(config, generator).items()
    }
    layers = [(tensors[f"{n}.weight"], tensors[f"{n}.bias"]) for n in layer_names(config)]
    loader, draw = _Loader(samples, device), LightDraw(light, options.light, options.seed)
    centers = torch.from_numpy(centers_mm.astype(np.float32)).to(device)
    scale = torch.tensor(config.target_scale, device=device)
    patch_scale = torch.tensor(config.patch_scale_n, device=device)[:, None, None]
    curve: list[tuple[int, float]] = []
    batches = _Batches(loader.count, options.batch, generator)

    def loss() -> torch.Tensor:
        rows = batches.next_rows().to(device)
        change, rest = loader.images(rows)
        moved = None if loader.moved is None else loader.moved[rows]
        predicted = forward(tensors, config, draw.lit(change, rest) / LEVELS, moved, centers)
        away = (predicted["targets"] - loader.targets[rows]) / scale
        sigma = predicted["sigma"] / scale
        likely = 0.5 * (away / sigma).square() + sigma.log()
        weighted = (sigma.detach() ** (2 * BETA) * likely).mean()
        by_patch = ((predicted["patches"] - loader.patches[rows]) / patch_scale).square().mean()
        return weighted + PATCH_WEIGHT * by_patch

    def after_step(step: int, value: torch.Tensor) -> None:
        if step % EVERY == 0 or step == options.steps:
            number = float(value.detach())
            if not math.isfinite(number):
                raise InputError(
                    f"the training diverged at step {step}; lower --learning-rate "
                    f"({options.learning_rate:g})"
                )
            curve.append((step, number))
            scalars({"loss": number}, step)
            progress(TASK, step, options.steps)

    keeper = None
    if kept is not None:
        key = training_key(samples, config, centers_mm, light, options, device)
        parts = {"batches": batches, "lights": draw}
        keeper = Keeper(kept, key, options.steps, tensors, curve, parts)
    descend(
        layers, loss, after_step,
        steps=options.steps, learning_rate=options.learning_rate, warm_up=WARM_UP, keeper=keeper,
    )  # fmt: skip
    return {name: value.detach().cpu().numpy().copy() for name, value in tensors.items()}, curve


def _initial(config: ForceModelConfig, generator: torch.Generator) -> dict[str, torch.Tensor]:
    """Weights as He et al. (2015) draw them, small ones where outputs are made, biases of zero."""
    found = {}
    for name, shape in config.weight_shapes().items():
        if name.startswith(COMPARED):
            continue
        if name.endswith(".bias"):
            found[name] = torch.zeros(shape)
            continue
        gain = 0.1 if name.startswith(("patch", "rest")) else math.sqrt(2.0)
        inputs = math.prod(shape[1:])
        found[name] = torch.randn(shape, generator=generator) * gain / math.sqrt(inputs)
    found["patch.bias"][3] = AREA_BIAS
    return found


def whitening(values: np.ndarray) -> np.ndarray:
    """Matrix [k, k] that gives values [n, k], less their mean, unit variances and no
    correlations."""
    count = values.shape[1]
    covariance = np.cov(values, rowvar=False).reshape(count, count)
    ridge = RIDGE * max(float(np.trace(covariance)) / count, 1e-12)
    factor = np.linalg.cholesky(covariance + ridge * np.eye(count))
    return np.linalg.inv(factor)


def tell(
    samples: ForceSamples,
    config: ForceModelConfig,
    weights: dict[str, np.ndarray],
    centers_mm: np.ndarray,
    light: LightSpread,
    options: ForceOptions,
    *,
    seed: int,
) -> Predictions:
    """What a network says of samples in drawn lights."""
    device = torch_device(options.device)
    tensors = {name: torch.from_numpy(value).to(device) for name, value in weights.items()}
    loader, draw = _Loader(samples, device), LightDraw(light, options.light, seed)
    centers = torch.from_numpy(centers_mm.astype(np.float32)).to(device)
    parts: list[dict[str, torch.Tensor]] = []
    with torch.no_grad():
        for start in range(0, loader.count, BATCH):
            rows = torch.arange(start, min(start + BATCH, loader.count), device=device)
            change = draw.lit(*loader.images(rows))
            moved = None if loader.moved is None else loader.moved[rows]
            parts.append(predictions_of(change, moved, config, tensors, centers))
    joined = {name: torch.cat([part[name] for part in parts]).cpu().numpy() for name in parts[0]}
    return Predictions.of(joined)


def predictions_of(
    change: torch.Tensor,
    moved: torch.Tensor | None,
    config: ForceModelConfig,
    tensors: dict[str, torch.Tensor],
    centers: torch.Tensor,
) -> dict[str, torch.Tensor]:
    """The network's outputs for changes of colour [levels], with statistics and distances; these
    are zero where nothing to compare with is known yet."""
    found = forward(tensors, config, change / LEVELS, moved, centers)
    found["statistics"], found["colors"] = image_statistics(change), color_reach(change)
    assert found["statistics"].shape[1] == STATISTICS and found["targets"].shape[1] == len(TARGETS)
    if "features.mean" in tensors:
        found["distances"] = distances(change, found["features"], tensors)
    else:
        found["distances"] = torch.zeros((len(change), 3), device=change.device)
    return found
