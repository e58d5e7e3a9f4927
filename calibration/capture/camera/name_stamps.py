# SPDX-License-Identifier: Apache-2.0
"""Stamps in the names of images, as exports of ROS bags have them.

A stamp is the time since 1970 in seconds (``1699999999.033.png``), in seconds and nanoseconds
(``1699999999_033000000.png``), or as one number of milliseconds, microseconds or nanoseconds
(``1699999999033000000.png``), which its count of digits tells. Counters and dates look otherwise:
stamps lie between 2001 and 2096, where seconds have ten digits.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from fractions import Fraction

_SECONDS = r"[123][0-9]{9}"
_STAMP = re.compile(
    rf"(?<![0-9.])(?:(?P<s>{_SECONDS})(?:\.(?P<part>[0-9]{{1,9}})|[-_](?P<ns>[0-9]{{9}}))?"
    rf"|(?P<whole>{_SECONDS}(?:[0-9]{{3}}){{1,3}}))(?![0-9])"
)


def name_stamps(names: Sequence[str]) -> list[float] | None:
    """Times [s] since the earliest, of file names without their endings.

    None where they are not told: unless every name has one stamp, names differ in nothing else (two
    cameras in one folder do) and no two stamps are the same.
    """
    found = [list(_STAMP.finditer(name)) for name in names]
    if not found or any(len(stamps) != 1 for stamps in found):
        return None
    around = {
        (name[: stamp.start()], name[stamp.end() :])
        for name, (stamp,) in zip(names, found, strict=True)
    }
    times = [_seconds(stamp) for (stamp,) in found]
    if len(around) > 1 or len(set(times)) < len(times):
        return None
    first = min(times)
    return [float(time - first) for time in times]


def _seconds(stamp: re.Match[str]) -> Fraction:
    """Exact, since a float holds a stamp to a quarter of a microsecond alone."""
    if stamp["whole"]:
        return Fraction(int(stamp["whole"]), 10 ** (len(stamp["whole"]) - 10))
    part = stamp["part"] or stamp["ns"] or "0"
    return int(stamp["s"]) + Fraction(int(part), 10 ** len(part))
