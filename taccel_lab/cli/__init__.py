# SPDX-License-Identifier: Apache-2.0
"""The command line: one module per sub-command, gathered in ``taccel_lab.cli.app``."""
