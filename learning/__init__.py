# SPDX-License-Identifier: Apache-2.0
"""Tasks as environments of a learning loop (the extra ``learning``)."""

from importlib.util import find_spec

from taccel_lab.errors import InputError

if find_spec("gymnasium") is None:
    raise InputError(
        "environments are gymnasium's, which is not installed: pip install 'taccel-lab[learning]'"
    )
