# SPDX-License-Identifier: Apache-2.0
"""Stepping a model: orchestration only."""

from taccel_lab.solvers.config import SolverConfig
from taccel_lab.solvers.control import Control
from taccel_lab.solvers.plan import Plan, PlanEntry
from taccel_lab.solvers.ready_steps import ReadySteps
from taccel_lab.solvers.solver_ipc import SolverIPC
from taccel_lab.solvers.step_report import EnvStatus, StepReport

__all__ = [
    "Control",
    "EnvStatus",
    "Plan",
    "PlanEntry",
    "ReadySteps",
    "SolverConfig",
    "SolverIPC",
    "StepReport",
]
