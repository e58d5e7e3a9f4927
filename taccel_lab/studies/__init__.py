# SPDX-License-Identifier: Apache-2.0
"""Design studies: many designs of a sensor, standard presses on each, figures of merit of all."""
