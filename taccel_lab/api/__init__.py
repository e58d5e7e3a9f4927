# SPDX-License-Identifier: Apache-2.0
"""What a script calls and a command prints: one call a job, equal defaults by construction."""
