# SPDX-License-Identifier: Apache-2.0
"""What a trial on a robot can come to; light, since the command line's help needs it."""

from typing import Literal, get_args

Outcome = Literal["success", "failure", "void"]
OUTCOMES: tuple[str, ...] = get_args(Outcome)
