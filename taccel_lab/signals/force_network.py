# SPDX-License-Identifier: Apache-2.0
"""The network of a force model, and what images and markers are turned into for it.

numpy and torch alone: trainings and readings share it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from taccel_lab.geometry import PixelGrid
from taccel_lab.networks.force_settings import (
    LOG_SIGMA,
    MARKER_UNIT_MM,
    STD_FLOOR,
    ForceModelConfig,
    color_directions,
)

if TYPE_CHECKING:
    import torch


def area_matrix(count: int, wanted: int) -> np.ndarray:
    """Means over ``wanted`` equal parts of ``count`` pixels, float32, shape [wanted, count]: rows
    sum to one, and pixels on a border belong to both parts by their share."""
    edges = np.linspace(0, count, wanted + 1)
    pixels = np.arange(count)
    low = np.maximum(edges[:-1, None], pixels)
    high = np.minimum(edges[1:, None], pixels + 1)
    return (np.maximum(high - low, 0) * (wanted / count)).astype(np.float32)


def reduced(images: np.ndarray, config: ForceModelConfig) -> np.ndarray:
    """Images [.., height, width, 3] of any size, averaged over the network's pixels, float32,
    [.., rows patch_px, columns patch_px, 3]. Bytes are exact in float32, and so are halved ones."""
    height, width = config.input_px
    left = area_matrix(images.shape[-3], height)
    right = area_matrix(images.shape[-2], width)
    levels = np.asarray(images, dtype=np.float32)
    return np.einsum(
        "yi,...ijc,xj->...yxc", left, levels, right, optimize=["einsum_path", (0, 1), (0, 1)]
    )


def patch_centers_mm(config: ForceModelConfig, grid: PixelGrid) -> np.ndarray:
    """Gel xy of the patches' centres, [row, column, 2]."""
    u = (np.arange(config.columns) + 0.5) * grid.width_px / config.columns - 0.5
    v = (np.arange(config.rows) + 0.5) * grid.height_px / config.rows - 0.5
    return grid.gel_from_pixel(np.stack(np.meshgrid(u, v), axis=-1))


def marker_planes(
    rest_px: np.ndarray, moved_px: np.ndarray, config: ForceModelConfig, grid: PixelGrid
) -> np.ndarray:
    """Motion of markers as the network sees it: means about each patch, float32,
    [3, row, column].

    Args:
        rest_px: Places at rest (u, v), [marker, 2]; the order of markers does not matter.
        moved_px: Ways from there, same shape; markers with NaN are left out.
        config: Of the network.
        grid: Of the images.
    """
    known = np.isfinite(rest_px).all(axis=1) & np.isfinite(moved_px).all(axis=1)
    at = grid.gel_from_pixel(np.asarray(rest_px, dtype=np.float64)[known])
    displacement = np.asarray(moved_px, dtype=np.float64)[known]
    displacement = displacement * [grid.mm_per_px_x, grid.mm_per_px_y] / MARKER_UNIT_MM
    away = patch_centers_mm(config, grid)[:, :, None] - at[None, None]
    weight = np.exp(-0.5 * (away**2).sum(axis=-1) / config.marker_reach_mm**2)
    total = weight.sum(axis=-1)
    mean = np.einsum("rcm,mx->xrc", weight, displacement) / (total + 0.1)
    return np.concatenate([mean, (total / (total + 1.0))[None]]).astype(np.float32)


def image_statistics(levels: torch.Tensor) -> torch.Tensor:
    """Simple statistics of changes of colour [levels], [n, 3, h, w]: [n, ``STATISTICS``]."""
    import torch

    mean = levels.mean(dim=(2, 3))
    away = levels - mean[:, :, None, None]
    std = away.square().mean(dim=(2, 3)).sqrt()
    inner = levels[:, :, 1:-1, 1:-1]
    around = (
        levels[:, :, :-2, 1:-1] + levels[:, :, 2:, 1:-1]
        + levels[:, :, 1:-1, :-2] + levels[:, :, 1:-1, 2:]
    )  # fmt: skip
    rough = (inner - 0.25 * around).square().mean(dim=(2, 3)).sqrt()
    pairs = [
        (away[:, a] * away[:, b]).mean(dim=(1, 2)) / (std[:, a] * std[:, b] + STD_FLOOR**2)
        for a, b in ((0, 1), (0, 2), (1, 2))
    ]
    largest = away.abs().amax(dim=(1, 2, 3))
    return torch.cat(
        [
            mean,
            (std + STD_FLOOR).log(),
            (rough + STD_FLOOR).log(),
            torch.stack(pairs, dim=1),
            (largest + STD_FLOOR).log()[:, None],
        ],
        dim=1,
    )


def mahalanobis(
    values: torch.Tensor, tensors: Mapping[str, torch.Tensor], name: str
) -> torch.Tensor:
    """Distance of values [n, k] from the training's, over the square root of k, [n]."""
    white = (values - tensors[f"{name}.mean"]) @ tensors[f"{name}.whiten"].T
    return white.square().mean(dim=1).sqrt()


def color_reach(levels: torch.Tensor) -> torch.Tensor:
    """Farthest that changes of colour [levels], [n, 3, h, w], go along each of ``color_directions``
    anywhere in the image, means of 3 x 3 px: [n, 26]."""
    import torch
    from torch.nn import functional

    mean = functional.avg_pool2d(levels, 3, stride=1)
    directions = torch.from_numpy(color_directions()).to(mean.device, mean.dtype)
    return torch.stack(
        [(mean * direction[:, None, None]).sum(dim=1).amax(dim=(1, 2)) for direction in directions],
        1,
    )


def distances(
    levels: torch.Tensor, features: torch.Tensor, tensors: Mapping[str, torch.Tensor]
) -> torch.Tensor:
    """Distances from the training's of changes of colour [levels], [n, 3, h, w], whose features
    [n, hidden] the network told. They are Mahalanobis distances of features and of statistics, and
    colours over the farthest that were trained, [n, 3]; before limits."""
    import torch

    return torch.stack(
        [
            mahalanobis(features, tensors, "features"),
            mahalanobis(image_statistics(levels), tensors, "statistics"),
            (color_reach(levels) / tensors["colors.most"]).amax(dim=1),
        ],
        dim=1,
    )


def layer_names(config: ForceModelConfig) -> list[str]:
    """Names of the network's layers in order."""
    down = [f"down{k}" for k in range(len(config.widths))]
    return [*down, *(f"block{k}" for k in range(config.blocks)), "patch", "hidden", "rest"]


def forward(
    tensors: Mapping[str, torch.Tensor],
    config: ForceModelConfig,
    change: torch.Tensor,
    moved: torch.Tensor | None,
    centers_mm: torch.Tensor,
) -> dict[str, torch.Tensor]:
    """The network.

    Args:
        tensors: Layers by name.
        config: Settings.
        change: Change of colour over ``LEVELS``, [n, 3, height, width].
        moved: ``marker_planes``, [n, 3, row, column]; None for a network without markers.
        centers_mm: Of the patches, [row, column, 2].

    Returns:
        ``patches`` [N], [n, 3, row, column]; ``targets``, [n, 7]; ``sigma``, of the same, before
        ``sigma_factor``; ``features``, [n, hidden].
    """
    import torch
    from torch.nn import functional

    like = {"dtype": change.dtype, "device": change.device}
    height, width = change.shape[2:]
    v = torch.linspace(-1, 1, height, **like)[:, None].expand(height, width)
    u = torch.linspace(-1, 1, width, **like)[None].expand(height, width)
    place = torch.stack([u, v])[None].expand(change.shape[0], -1, -1, -1)
    x = torch.cat([change, place], dim=1)
    for k in range(len(config.widths)):
        weight, bias = tensors[f"down{k}.weight"], tensors[f"down{k}.bias"]
        x = functional.silu(functional.conv2d(x, weight, bias, stride=2, padding=1))
    for k in range(config.blocks):
        seen = x if k or moved is None else torch.cat([x, moved], dim=1)
        weight, bias = tensors[f"block{k}.weight"], tensors[f"block{k}.bias"]
        x = x + functional.silu(functional.conv2d(seen, weight, bias, padding=1))
    by_patch = functional.conv2d(x, tensors["patch.weight"], tensors["patch.bias"])
    patches = by_patch[:, :3] * torch.tensor(config.patch_scale_n, **like)[:, None, None]
    scale = torch.tensor(config.target_scale, **like)
    area = functional.softplus(by_patch[:, 3]).sum(dim=(1, 2)) * scale[6]
    pooled = torch.cat([x.mean(dim=(2, 3)), x.amax(dim=(2, 3))], dim=1)
    features = functional.silu(functional.linear(pooled, *_pair(tensors, "hidden")))
    rest = functional.linear(features, *_pair(tensors, "rest"))
    force = patches.sum(dim=(2, 3))
    moment = moment_of(patches, centers_mm) + rest[:, :3] * scale[3:6]
    targets = torch.cat([force, moment, area[:, None]], dim=1)
    sigma = rest[:, 3:].clamp(*LOG_SIGMA).exp() * scale
    return {"patches": patches, "targets": targets, "sigma": sigma, "features": features}


def _pair(tensors: Mapping[str, torch.Tensor], name: str) -> tuple[torch.Tensor, torch.Tensor]:
    return tensors[f"{name}.weight"], tensors[f"{name}.bias"]


def moment_of(patches: torch.Tensor, centers_mm: torch.Tensor) -> torch.Tensor:
    """Moment about the gel's origin [N mm] of forces [n, 3, row, column] at the patches' centres
    [row, column, 2], which lie in the plane z = 0; [n, 3]."""
    import torch

    x, y = centers_mm[..., 0], centers_mm[..., 1]
    fx, fy, fz = patches.unbind(dim=1)
    parts = (y * fz, -x * fz, x * fy - y * fx)
    return torch.stack([part.sum(dim=(1, 2)) for part in parts], dim=1)
