# SPDX-License-Identifier: Apache-2.0
"""Two paths change places in one step of the file system: no reader finds either missing."""

from __future__ import annotations

import ctypes
import errno
import os
import sys
from functools import cache
from pathlib import Path
from typing import Any

_AT_FDCWD = -100
_SWAP = 2
"""RENAME_EXCHANGE of Linux's renameat2 and RENAME_SWAP of macOS's renamex_np."""
_UNABLE = {errno.ENOSYS, errno.EINVAL, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EXDEV, errno.EPERM}
"""What systems and file systems answer that cannot exchange."""


def exchange(one: Path, other: Path) -> bool:
    """Let two existing paths of one file system change places.

    Returns whether they did; False where the system or the file system has no such call (NFS and
    other network drives, some containers), and nothing has changed. Raises OSError as
    ``os.rename`` does; FileNotFoundError when either is absent.
    """
    swap = _system_call()
    if swap is None or swap(os.fsencode(one), os.fsencode(other)) == 0:
        return swap is not None
    code = ctypes.get_errno()
    if code in _UNABLE:
        return False
    raise OSError(code, os.strerror(code), str(one), None, str(other))


@cache
def _system_call() -> Any:
    """The call of this system with two names, 0 for success; None where there is none."""
    library = ctypes.CDLL(None, use_errno=True)
    names = [ctypes.c_char_p, ctypes.c_char_p]
    if sys.platform == "darwin" and hasattr(library, "renamex_np"):
        call = library.renamex_np
        call.argtypes = [*names, ctypes.c_uint]
        return lambda one, other: call(one, other, _SWAP)
    if hasattr(library, "renameat2"):
        call = library.renameat2
        call.argtypes = [ctypes.c_int, names[0], ctypes.c_int, names[1], ctypes.c_uint]
        return lambda one, other: call(_AT_FDCWD, one, _AT_FDCWD, other, _SWAP)
    return None
