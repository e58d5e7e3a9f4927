# SPDX-License-Identifier: Apache-2.0
"""Moulds for casting gels: cavity and lid with draft, gates, pins and shrinkage."""

from taccel_lab.cad.moulds.checks import MouldReport, casting_moulds, check_mould
from taccel_lab.cad.moulds.two_part import Mould, MouldOptions, gel_mould

__all__ = ["Mould", "MouldOptions", "MouldReport", "casting_moulds", "check_mould", "gel_mould"]
