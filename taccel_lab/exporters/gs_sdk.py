# SPDX-License-Identifier: Apache-2.0
"""gs_sdk's device file, background and network from colour and position to gradients.

https://github.com/joehjhuang/gs_sdk (its configuration key ``ppmm`` holds millimetres per pixel).
The network gets blue, green, red and the pixel's place, all from 0 to 1, and gives
``atan(dh/dx), atan(dh/dy)`` of the height h over the gel, x along rows and y down them.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.exporters.press_samples import ColorSource, PressPixels
from taccel_lab.exporters.record import ExportRecord, required
from taccel_lab.files.atomic_file import write_by, write_image
from taccel_lab.profile import SensorProfile
from taccel_lab.signals.normals import normals_from_slopes

if TYPE_CHECKING:
    import torch

WIDTHS = (5, 32, 32, 32, 2)
SAMPLES = 60_000
CHECKED = 10_000
STEPS = 8_000
BATCH = 1024
LEARNING_RATE = 3e-3
NOISE_LEVELS = 1.0
"""Standard deviation of a pixel's noise, where the profile has no perturbation block: a network
without it would read grey levels that no camera resolves."""
FLAT_SHARE = 0.15
"""Share of the samples that show untouched gel."""
IN_CONTACT = 0.8
"""Share of the others that lie inside a contact."""
DEFAULT_RATE_HZ = 25


def export_gs_sdk(
    profile: SensorProfile, folder: Path, *, steps: int = STEPS, samples: int = SAMPLES
) -> ExportRecord:
    """Write ``device.yaml``, ``nnmodel.pth`` and ``background.png``; needs color and background."""
    import torch
    import yaml

    required(profile, "color", "a gs_sdk network", profile.color)
    background = required(profile, "background", "a gs_sdk network", profile.background_rgb)
    source = ColorSource(profile)
    grid = profile.grid()
    scale = float(np.sqrt(grid.mm_per_px_x * grid.mm_per_px_y))
    stretch = np.array([grid.mm_per_px_x, grid.mm_per_px_y]) / scale
    noise = (
        NOISE_LEVELS
        if profile.perturbation is None
        else max(profile.perturbation.noise_levels, 0.5)
    )
    rng = np.random.default_rng(0)
    train = _examples(source, background, stretch, noise, rng, samples)
    weights = train_network(*train, steps=steps)
    errors = _errors(weights, *_examples(source, background, stretch, noise, rng, CHECKED))

    state = {name: torch.from_numpy(value.copy()) for name, value in weights.items()}
    write_by(folder / "nnmodel.pth", partial(torch.save, state))
    write_image(folder / "background.png", background)
    raw = (0, 0) if profile.optics is None else _raw_size(profile)
    device = {
        "device_name": profile.sensor.name,
        "ppmm": scale,
        "imgh": grid.height_px,
        "imgw": grid.width_px,
        "raw_imgh": raw[1] or grid.height_px,
        "raw_imgw": raw[0] or grid.width_px,
        "framerate": DEFAULT_RATE_HZ,
    }
    text = "# gs_sdk device file, written by taccel-lab; ppmm is millimetres per pixel.\n"
    text += yaml.safe_dump(device, sort_keys=False)
    (folder / "device.yaml").write_text(text, encoding="utf-8")

    record = ExportRecord(
        carries={
            "color": "inverted: a 5-32-32-32-2 network trained on what the colour model shows of "
            + source.describe(),
            "background": "as background.png, 8 bit, for Reconstructor.load_bg",
            "camera": "image size and scale",
        },
        approximations={
            **errors,
            "noise_levels": noise,
            "scale_difference": abs(grid.mm_per_px_x / grid.mm_per_px_y - 1),
        },
        notes=[
            "Reconstructor('nnmodel.pth'); load_bg(cv2.imread('background.png')); images are BGR "
            "with the profile's rows and columns; heights come in pixels, times ppmm in mm, "
            "negative in a dent",
            "gradients are over the gel at rest: gs_sdk subtracts what the network gives for the "
            "background",
            "load it with github.com/joehjhuang/gs_sdk: the gs_sdk on PyPI is another project",
            f"framerate {DEFAULT_RATE_HZ} is assumed: no block of the profile says it",
        ],
    )
    if not (raw[0] and raw[1]):
        record.left_out["optics.raw_size"] = (
            "the size of the camera's own pictures is unknown; the tactile image's is given"
        )
    elif profile.optics is not None and min(profile.optics.crop_x, profile.optics.crop_y) < 1:
        record.left_out["optics.crop"] = "gs_sdk works out its own crop from the two sizes"
    if profile.normals is not None:
        record.left_out["normals"] = (
            "its inputs are not gs_sdk's; the network was made from the colour model instead"
        )
    record.dots_stand_still(profile)
    if profile.markers is not None:
        record.notes.append("dots of a gel confuse gs_sdk's network")
    return record


def _raw_size(profile: SensorProfile) -> tuple[int, int]:
    optics = profile.optics
    assert optics is not None
    return optics.raw_width_px, optics.raw_height_px


def _examples(
    source: ColorSource,
    background: np.ndarray,
    stretch: np.ndarray,
    noise: float,
    rng: np.random.Generator,
    count: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Features [n, 5] and angles [n, 2] of pixels of presses."""
    drawn = source.draw(rng, count, IN_CONTACT)
    flat = rng.uniform(size=count) < FLAT_SHARE
    drawn = PressPixels(
        drawn.pixel_idx,
        np.where(flat[:, None], 0.0, drawn.slope),
        np.where(flat, 0.0, drawn.displacement_mm),
    )
    change = source.change(drawn.pixel_idx, drawn.slope, drawn.displacement_mm)
    rgb = background.reshape(-1, 3)[drawn.pixel_idx] + change
    rgb = np.clip(rgb + rng.normal(0, noise, rgb.shape), 0, 255)
    config = source.model.config
    features = np.concatenate(
        [
            rgb[:, ::-1] / 255,
            (drawn.pixel_idx % config.width_px)[:, None] / config.width_px,
            (drawn.pixel_idx // config.width_px)[:, None] / config.height_px,
        ],
        axis=1,
    )
    return features.astype(np.float32), np.arctan(drawn.slope * stretch).astype(np.float32)


def train_network(
    features: np.ndarray, angles: np.ndarray, *, steps: int, seed: int = 0
) -> dict[str, np.ndarray]:
    """State dict ``fc1.weight`` ... ``fc4.bias``; L1 loss, as gs_sdk trains it."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        generator = torch.Generator().manual_seed(seed)
        # Trained on centred features, which the first layer then takes in.
        mean, spread = features.mean(axis=0), features.std(axis=0) + 1e-6
        x = torch.from_numpy((features - mean) / spread)
        y = torch.from_numpy(angles)
        layers = [torch.nn.Linear(fan_in, fan_out) for fan_in, fan_out in pairwise(WIDTHS)]
        for layer in layers:
            torch.nn.init.kaiming_uniform_(layer.weight, nonlinearity="relu", generator=generator)
            torch.nn.init.zeros_(layer.bias)
        parameters = [p for layer in layers for p in layer.parameters()]
        optimizer = torch.optim.Adam(parameters, lr=LEARNING_RATE)
        decay = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            batch = torch.randint(len(x), (BATCH,), generator=generator)
            loss = torch.nn.functional.l1_loss(_forward(layers, x[batch]), y[batch])
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            decay.step()
    finally:
        torch.set_num_threads(threads)
    state: dict[str, np.ndarray] = {}
    for number, layer in enumerate(layers, start=1):
        state[f"fc{number}.weight"] = layer.weight.detach().numpy()
        state[f"fc{number}.bias"] = layer.bias.detach().numpy()
    first = state["fc1.weight"] / spread
    state["fc1.bias"] = (state["fc1.bias"] - first @ mean).astype(np.float32)
    state["fc1.weight"] = first.astype(np.float32)
    return state


def _forward(layers: list[torch.nn.Linear], x: torch.Tensor) -> torch.Tensor:
    import torch

    for layer in layers[:-1]:
        x = torch.relu(layer(x))
    return layers[-1](x)


def network_angles(state: Mapping[str, np.ndarray], features: np.ndarray) -> np.ndarray:
    """The network's angles [rad], shape [n, 2], of features [n, 5]."""
    x = features
    for number in range(1, len(WIDTHS)):
        x = x @ state[f"fc{number}.weight"].T + state[f"fc{number}.bias"]
        if number < len(WIDTHS) - 1:
            x = np.maximum(x, 0)
    return x


def _errors(
    state: Mapping[str, np.ndarray], features: np.ndarray, angles: np.ndarray
) -> dict[str, float]:
    """Angles between normals, on pixels that the network was not trained on."""
    off = _angle_between(network_angles(state, features), angles)
    tilt = _angle_between(np.zeros_like(angles), angles)
    touched = tilt > 1e-3
    return {
        "normal_mean_deg": float(np.rad2deg(off[touched].mean())),
        "normal_median_deg": float(np.rad2deg(np.median(off[touched]))),
        "normal_p90_deg": float(np.rad2deg(np.quantile(off[touched], 0.9))),
        "normal_at_rest_mean_deg": float(np.rad2deg(off[~touched].mean())),
        "tilt_mean_deg": float(np.rad2deg(tilt[touched].mean())),
    }


def _angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    one, other = (normals_from_slopes(np.tan(angles)) for angles in (first, second))
    return np.arccos(np.clip((one * other).sum(axis=1), -1, 1))
