# SPDX-License-Identifier: Apache-2.0
"""Poses in torch: x, y, z [m], quaternion x, y, z, w; the last axis has 7 of them."""

from __future__ import annotations

import torch


def about_z(angle: torch.Tensor) -> torch.Tensor:
    """Quaternions of turns about z [rad], [..., 4]."""
    zero = torch.zeros_like(angle)
    return torch.stack([zero, zero, torch.sin(angle / 2), torch.cos(angle / 2)], dim=-1)


def rotated(turn: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    """Vectors [..., 3] turned by quaternions [..., 4]."""
    axis, vector = torch.broadcast_tensors(turn[..., :3], vector)
    once = 2 * torch.cross(axis, vector, dim=-1)
    return vector + turn[..., 3:] * once + torch.cross(axis, once, dim=-1)


def compose(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
    """The second pose, given in the frame of the first, in that frame's own frame."""
    p, q = first[..., 3:6], first[..., 6:]
    u, w = second[..., 3:6], second[..., 6:]
    p_, u_ = torch.broadcast_tensors(p, u)
    place = first[..., :3] + rotated(first[..., 3:], second[..., :3])
    imaginary = q * u + w * p + torch.cross(p_, u_, dim=-1)
    return torch.cat([place, imaginary, q * w - (p_ * u_).sum(dim=-1, keepdim=True)], dim=-1)


def planar_inverse(start: torch.Tensor) -> torch.Tensor:
    """Inverse poses of places in the plane, x [mm], y [mm] and turn about z [degrees], [env, 3]."""
    yaw = torch.deg2rad(start[:, 2])
    back = about_z(-yaw)
    place = torch.cat([-1e-3 * start[:, :2], torch.zeros_like(start[:, :1])], dim=1)
    return torch.cat([rotated(back, place), back], dim=1)
