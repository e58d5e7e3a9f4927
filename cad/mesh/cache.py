# SPDX-License-Identifier: Apache-2.0
"""Meshes kept by the content that made them, so that slow or unrepeatable meshing runs once."""

from __future__ import annotations

import hashlib
import json
import os
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.output import atomic_file, to_jsonable

CACHE_VARIABLE = "TACCEL_LAB_CACHE"
_ARRAYS = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")


def cache_folder() -> Path:
    """$TACCEL_LAB_CACHE, or taccel_lab in $XDG_CACHE_HOME or ~/.cache."""
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "taccel_lab"


def content_key(recipe: dict[str, Any]) -> str:
    """SHA-256 of a recipe of plain values and arrays; equal recipes give equal keys."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            data = np.ascontiguousarray(value)
            digest = hashlib.sha256(data.tobytes()).hexdigest()
            return {"array": digest, "shape": list(data.shape), "dtype": data.dtype.str}
        return to_jsonable(value)

    text = json.dumps({k: plain(v) for k, v in recipe.items()}, sort_keys=True, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


def cached_mesh(recipe: dict[str, Any], build: Callable[[], TetMesh]) -> TetMesh:
    """The mesh of ``recipe`` from the cache, or ``build()``, which is then kept.

    A damaged file is reported with a warning and rebuilt.
    """
    path = cache_folder() / "meshes" / f"{content_key(recipe)}.npz"
    if path.exists():
        try:
            with np.load(path, allow_pickle=False) as stored:
                return TetMesh(**{name: stored[name] for name in _ARRAYS})
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            warnings.warn(f"cached mesh {path} is damaged ({error}): rebuilt", stacklevel=2)
    mesh = build()
    try:
        with atomic_file(path) as staging:
            np.savez_compressed(staging, **{name: getattr(mesh, name) for name in _ARRAYS})
    except OSError as error:
        raise InputError(
            f"cannot write the mesh cache {path.parent} ({error.strerror}); set "
            f"{CACHE_VARIABLE} to a folder that can be written"
        ) from error
    return mesh
