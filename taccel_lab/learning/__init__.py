# SPDX-License-Identifier: Apache-2.0
"""What learns from simulations: tasks as environments of a learning loop, and force networks."""
