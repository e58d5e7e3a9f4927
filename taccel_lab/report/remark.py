# SPDX-License-Identifier: Apache-2.0
"""What a person has to know of a result, and the verdict that it leaves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum


class Verdict(StrEnum):
    """How far a calibrated block can be trusted; a refusal is an InputError, not a verdict."""

    GOOD = "good"
    USABLE = "usable"
    WEAK = "weak"


class Severity(StrEnum):
    """What a remark does to the verdict: nothing, at most usable, at most weak."""

    INFO = "info"
    WARNING = "warning"
    ERROR = "error"


@dataclass(frozen=True)
class Remark:
    """One thing that a user has to know, in a sentence with figures and what to do."""

    severity: Severity
    code: str
    """Stable name for programs, such as ``scale_disagrees``."""
    message: str
    frames: tuple[str, ...] = ()
    """Names of the images it is about; empty: all, or none in particular."""
    blocks: tuple[str, ...] = ()
    """Blocks that a finding about captures stops (error) or harms (warning); empty for a remark
    about one calibration."""

    def __str__(self) -> str:
        return f"{self.severity}: {self.message}"


def judge(remarks: Iterable[Remark]) -> Verdict:
    """The verdict that remarks leave."""
    found = {remark.severity for remark in remarks}
    if Severity.ERROR in found:
        return Verdict.WEAK
    return Verdict.USABLE if Severity.WARNING in found else Verdict.GOOD
