# SPDX-License-Identifier: Apache-2.0
"""Bridge to newton-physics: its models in, our gels in its solvers and viewers.

Newton itself (the extra ``newton``) loads with the first call that needs it.
"""

from taccel_lab.newton_bridge.importing import NewtonScene, import_model
from taccel_lab.newton_bridge.robot_files import load_mjcf, load_usd

__all__ = ["NewtonScene", "import_model", "load_mjcf", "load_usd"]
