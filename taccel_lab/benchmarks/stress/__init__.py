# SPDX-License-Identifier: Apache-2.0
"""Stability stress: hundreds of random scenes over extremes, each judged by independent referees.

A *case* is a family (``stress/families``) and a seed, from which its parameters are drawn:
``taccel-lab bench stress --replay FAMILY:SEED`` runs it again, step by step. It takes a
bounded number of steps within a budget of time. A step that fails with a cause and leaves the state
where it was is a failure that a user can see and act on; one that claims to have converged while a
referee objects (``referees.py``) is *silent*, and must not be.
"""
