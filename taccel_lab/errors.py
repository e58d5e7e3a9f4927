# SPDX-License-Identifier: Apache-2.0
"""Errors that are addressed to a user of the tool rather than to its programmer."""

from __future__ import annotations


class InputError(ValueError):
    """Input that cannot be used: a file, an option or a parameter.

    The message names the file or parameter, says what was found and what is allowed. The command
    line prints it without a traceback and exits with code 2.
    """


class SimulationError(RuntimeError):
    """A simulation that did not reach its stated tolerance, with the cause and the numbers.

    The command line prints it without a traceback and exits with code 3.
    """
