# SPDX-License-Identifier: Apache-2.0
"""The public names and their modules; read by type checkers and by ``lazy_names``."""

from taccel_lab.solvers.config import Control as Control
from taccel_lab.solvers.config import SolverConfig as SolverConfig
from taccel_lab.solvers.plan import Plan as Plan
from taccel_lab.solvers.plan import PlanEntry as PlanEntry
from taccel_lab.solvers.ready_steps import ReadySteps as ReadySteps
from taccel_lab.solvers.solver_ipc import SolverIPC as SolverIPC
from taccel_lab.solvers.step_report import EnvStatus as EnvStatus
from taccel_lab.solvers.step_report import StepReport as StepReport
