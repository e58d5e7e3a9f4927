# SPDX-License-Identifier: Apache-2.0
"""Moulds for casting gels: cavity and lid with draft, gates, pins and shrinkage."""

from taccel_lab.cad.moulds.casting import casting_moulds
from taccel_lab.cad.moulds.checks import MouldReport, check_mould
from taccel_lab.cad.moulds.options import MouldOptions
from taccel_lab.cad.moulds.two_part import Mould, gel_mould

__all__ = ["Mould", "MouldOptions", "MouldReport", "casting_moulds", "check_mould", "gel_mould"]
