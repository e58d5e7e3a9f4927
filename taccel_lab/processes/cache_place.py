# SPDX-License-Identifier: Apache-2.0
"""Where results that are slow to make are kept: ours, Warp's kernels, matplotlib's fonts."""

from __future__ import annotations

import logging
import os
from pathlib import Path

from taccel_lab.errors import InputError

CACHE_VARIABLE = "TACCEL_LAB_CACHE"
"""Environment variable that names the cache folder."""
_SYSTEMS_VARIABLE = "XDG_CACHE_HOME"
_WARPS_VARIABLE = "WARP_CACHE_PATH"
_FONTS_VARIABLE = "MPLCONFIGDIR"


def cache_folder() -> Path:
    """$TACCEL_LAB_CACHE, or taccel_lab in $XDG_CACHE_HOME or ~/.cache.

    Raises:
        InputError: Neither is set and the user has no home folder, as in many containers.
    """
    named = os.environ.get(CACHE_VARIABLE)
    return Path(named) if named else _users_caches() / "taccel_lab"


def place_kernels() -> None:
    """Have Warp keep its kernels in our cache folder where $TACCEL_LAB_CACHE names one; for this
    process and those that it starts, before Warp starts. $WARP_CACHE_PATH goes first.

    Raises:
        InputError: Nothing says where, and the user has no home folder: Warp would make a folder
            of the name ~ where the process happens to be.
    """
    if os.environ.get(_WARPS_VARIABLE):
        return
    named = os.environ.get(CACHE_VARIABLE)
    if named:
        os.environ[_WARPS_VARIABLE] = str(Path(named).absolute() / "warp")
    elif not os.environ.get(_SYSTEMS_VARIABLE):
        _users_caches()
        # Warp takes an empty one for the folder where the process happens to be.
        os.environ.pop(_SYSTEMS_VARIABLE, None)


def kernels_variable() -> str:
    """Name of the environment variable that moves Warp's kernels: $WARP_CACHE_PATH where the user
    set it, ours otherwise."""
    named, kept = os.environ.get(CACHE_VARIABLE), os.environ.get(_WARPS_VARIABLE)
    ours = named and str(Path(named).absolute() / "warp")
    return CACHE_VARIABLE if not kept or kept == ours else _WARPS_VARIABLE


def place_fonts() -> None:
    """Have matplotlib keep its list of fonts in our cache folder where $TACCEL_LAB_CACHE names one
    and the user has no home folder: it would make a list anew, and say so, in every run."""
    named = os.environ.get(CACHE_VARIABLE)
    if named and not os.access(os.path.expanduser("~"), os.W_OK):
        os.environ.setdefault(_FONTS_VARIABLE, str(Path(named).absolute() / "matplotlib"))
        # The first run makes it, which a slow machine would be told of.
        logging.getLogger("matplotlib.font_manager").setLevel(logging.ERROR)


def _users_caches() -> Path:
    named = os.environ.get(_SYSTEMS_VARIABLE)
    if named:
        return Path(named)
    try:
        return Path.home() / ".cache"
    except RuntimeError:
        raise InputError(
            f"there is no home folder to keep compiled kernels and meshes in; set {CACHE_VARIABLE} "
            "to a folder that can be written"
        ) from None
