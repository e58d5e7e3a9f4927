# SPDX-License-Identifier: Apache-2.0
"""Resultant of nodal contact forces about the origin: ``F = sum f_i``, ``M = sum x_i x f_i``."""

from __future__ import annotations

from typing import Any

import numpy as np

from taccel_lab.errors import InputError


def resultant_wrench(positions: Any, forces: Any) -> np.ndarray:
    """Force and moment of nodal forces about the origin of the gel frame.

    Args:
        positions: Node positions in the gel frame [m], shape [env, node, 3], numpy or Warp.
        forces: Contact force on each node [N], same shape and frame. Forces on the gel give the
            load that the object puts on the gel; its reaction is the negative.

    Returns:
        (Fx, Fy, Fz, Mx, My, Mz) [N, N m], shape [env, 6].

    Raises:
        InputError: Shapes that differ or are not [env, node, 3], NaN or infinite values.
    """
    x = _as_array("positions", positions)
    f = _as_array("forces", forces)
    if x.shape != f.shape:
        raise InputError(f"positions has shape {x.shape} but forces has shape {f.shape}")
    return np.concatenate([f.sum(axis=1), np.cross(x, f).sum(axis=1)], axis=1)


def _as_array(name: str, value: Any) -> np.ndarray:
    array = value.numpy() if hasattr(value, "numpy") else np.asarray(value)
    array = array.astype(np.float64, copy=False)
    if array.ndim != 3 or array.shape[2] != 3:
        raise InputError(f"{name} has shape {array.shape}; [env, node, 3] is needed")
    if not np.isfinite(array).all():
        bad = np.flatnonzero(~np.isfinite(array).all(axis=(1, 2))).tolist()
        raise InputError(f"{name} holds NaN or infinite values in environments {bad}")
    return array
