# SPDX-License-Identifier: Apache-2.0
"""Warp started: its kernels where they can be kept, without lines that are for its developers."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
import warnings
from functools import wraps
from pathlib import Path
from typing import Any

import warp as wp

from taccel_lab.errors import InputError, InputWarning
from taccel_lab.processes.cache_place import kernels_variable, place_kernels

_DRIVERS = ("libcuda.so", "libcuda.so.1")
_started: list[bool] = []
"""Whether this process has called Warp's initialisation."""


def start_warp() -> None:
    """Initialise Warp, unless it is, without its lines on modules loaded and, where there is no
    GPU, on a missing driver, which its library writes to the standard error of the process itself.

    ``wp.config.log_level`` set afterwards brings its lines back.

    Raises:
        InputError: There is no folder for its kernels that can be written.
    """
    if _started:
        return
    wp.config.log_level = wp.LOG_ERROR
    if sys.platform != "linux" or any(map(_loads, _DRIVERS)):
        _initialise()
        return
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        _initialise()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _initialise() -> None:
    if wp.config.kernel_cache_dir is None:
        place_kernels()
    try:
        wp.init()
    except OSError as error:
        raise _unkept(error) from None
    _rebuild_what_is_damaged()
    _started.append(True)


def _unkept(error: OSError) -> InputError:
    where = error.filename2 or error.filename or wp.config.kernel_cache_dir
    return InputError(
        f"Warp cannot keep its kernels in {where} ({error.strerror or error}); set "
        f"{kernels_variable()} to a folder that can be written"
    )


def _rebuild_what_is_damaged() -> None:
    """Have Warp compile a module again whose kept files cannot be loaded, where it would end; and
    say in a sentence where it can keep none."""
    modules = type(wp.get_module(__name__))
    load = modules.load

    @wraps(load)
    def loaded(module: Any, device: Any, block_dim: int | None = None, **given: Any) -> Any:
        try:
            return load(module, device, block_dim, **given)
        except Exception as error:
            size = module.options["block_dim"] if block_dim is None else block_dim
            folder = Path(wp.config.kernel_cache_dir or "") / module.get_module_identifier(size)
            if given or isinstance(error, InputError) or not any(folder.glob("*.meta")):
                if isinstance(error, OSError) and not given:
                    raise _unkept(error) from None
                raise
            said = f"kept kernels {folder} are damaged ({error})"
            try:
                shutil.rmtree(folder)
            except OSError as why:
                raise InputError(
                    f"{said} and cannot be removed ({why.strerror}); remove them, or set "
                    f"{kernels_variable()} to a folder that can be written"
                ) from None
            warnings.warn(InputWarning(f"{said}: made again"), stacklevel=2)
        return load(module, device, block_dim)

    modules.load = loaded


def first_step() -> str:
    """What a press does before its first step: in a cache of kernels without a solver it compiles
    one, which needs no second time on this machine."""
    cache = Path(wp.config.kernel_cache_dir or "")
    if any(cache.glob("wp_taccel_lab.solvers.*")):
        return "first step"
    return "compiling the solver, once on this machine: about 30 s"


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
