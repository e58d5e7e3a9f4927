# SPDX-License-Identifier: Apache-2.0
"""gymnasium, which the extra ``learning`` brings, or a sentence that says so where it is missing.

Environments take it from here; force networks, trained without it, stand in the same folder.
"""

from importlib.util import find_spec

from taccel_lab.errors import InputError

if find_spec("gymnasium") is None:
    raise InputError(
        "environments are gymnasium's, which is not installed: pip install 'taccel-lab[learning]'"
    )

from gymnasium import Env, spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

__all__ = ["AutoresetMode", "Env", "VectorEnv", "batch_space", "spaces"]
