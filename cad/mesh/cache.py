# SPDX-License-Identifier: Apache-2.0
"""Meshes kept by the content that made them, so that slow or unrepeatable meshing runs once."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.geometry import TetMesh
from taccel_lab.output import CACHE_VARIABLE, atomic_file, cache_folder, content_key

_ARRAYS = ("nodes_m", "tets", "faces", "face_regions", "tet_layers")


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
