# SPDX-License-Identifier: Apache-2.0
"""The array files of a profile as bytes: mesh and background as npz, weights as safetensors.

Encoding is deterministic (equal arrays give equal bytes), so that hashes can be compared between
profiles. Decoding refuses what it does not expect: missing or extra keys, wrong types, pickles.
"""

from __future__ import annotations

import io
from collections.abc import Mapping

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.files.arrays import unpack_npz
from taccel_lab.geometry import TetMesh
from taccel_lab.geometry.tet_checks import check_connectivity

MESH_KEYS = ("nodes_m", "tets", "faces", "face_regions")
LAYER_KEY = "tet_layers"
"""Stored beside them for a gel of several layers."""


def _encode_npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    # numpy stamps zip members with a fixed date, hence the determinism.
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def _decode_npz(
    data: bytes, keys: tuple[str, ...], optional: tuple[str, ...] = ()
) -> dict[str, np.ndarray]:
    arrays = unpack_npz(data)
    if not set(keys) <= arrays.keys() <= {*keys, *optional}:
        raise InputError(f"must hold the arrays {sorted(keys)}, found {sorted(arrays)}")
    return arrays


def encode_mesh(mesh: TetMesh) -> bytes:
    """Bytes of ``mesh.npz``."""
    keys = (*MESH_KEYS, LAYER_KEY) if mesh.tet_layers.any() else MESH_KEYS
    return _encode_npz({key: getattr(mesh, key) for key in keys})


def decode_mesh(data: bytes) -> TetMesh:
    """The mesh in ``mesh.npz``; raises InputError when it is damaged or not a valid mesh."""
    arrays = _decode_npz(data, MESH_KEYS, (LAYER_KEY,))
    for key, array in arrays.items():
        kind = "f" if key == "nodes_m" else "i"
        if array.dtype.kind != kind:
            raise InputError(f"{key} has type {array.dtype}, which is not a {kind}-type")
    mesh = TetMesh(**arrays)
    check_connectivity(mesh, "the mesh")
    return mesh


def encode_background(rgb: np.ndarray) -> bytes:
    """Bytes of ``background.npz``; ``rgb`` has shape [H, W, 3], uint8 or float32."""
    return _encode_npz({"rgb": rgb})


def decode_background(data: bytes) -> np.ndarray:
    """The RGB image in ``background.npz``, shape [H, W, 3]."""
    return _decode_npz(data, ("rgb",))["rgb"]


def encode_weights(weights: Mapping[str, np.ndarray]) -> bytes:
    """Bytes of ``color_model.safetensors``."""
    from safetensors.numpy import save

    # safetensors writes the raw buffer: a transposed view would be stored scrambled.
    return save({name: np.ascontiguousarray(weights[name]) for name in sorted(weights)})


def decode_weights(data: bytes) -> dict[str, np.ndarray]:
    """The named weights in ``color_model.safetensors``."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        return load(data)
    except (SafetensorError, ValueError, KeyError) as error:
        raise InputError(f"is not a readable safetensors file ({error})") from None
