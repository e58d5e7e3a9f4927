# SPDX-License-Identifier: Apache-2.0
"""Sensor profiles: one validated, versioned folder that says everything about a sensor.

The public names of ``__init__.pyi`` load their modules on first use: the plain data of
``optical_design`` is for machines without pydantic, too.
"""

from taccel_lab.lazy_names import lazy_names

__getattr__, __dir__, __all__ = lazy_names(__name__, __file__)
