# SPDX-License-Identifier: Apache-2.0
"""One block that captures calibrate, with all that is asked of it: the fit, the check of its
captures, the command, the reports and the help know a block by this alone.

A block stands in a folder of its own, whose ``block.py`` holds its ``BLOCK``. What loads libraries
is named there as ``module:name`` of that folder, and loaded when it is used.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, NamedTuple

from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent

if TYPE_CHECKING:
    from taccel_lab.calibration.capture.folder import CaptureFolder
    from taccel_lab.calibration.result import BlockResult
    from taccel_lab.profile import SensorProfile
    from taccel_lab.report.lead import Score
    from taccel_lab.report.page import Page
    from taccel_lab.report.remark import Remark

Files = Mapping[Path, Callable[[Path], None]]
"""Files that were asked for, with what writes them."""
Residuals = Mapping[str, float]
"""Residuals of a block's evidence, by their names."""


class Needs(NamedTuple):
    """Contents of captures for a block, and their lack, in words; empty for none."""

    found: str
    missing: str = ""


@dataclass(frozen=True)
class BlockWords:
    """Options of ``taccel-lab calibrate NAME``, besides those that all blocks have; the docstring
    is the command's help. Words of a block whose options can be written inherit these."""

    def check(self) -> None:
        """Refuse options that cannot be used before anything is read."""

    def options(self, base: SensorProfile | None) -> Any:
        """Options of the fit; ``base`` is the profile that was given to extend."""
        return self

    def files(self, result: Any) -> Files:
        """Further files that were asked for."""
        return {}


@dataclass(frozen=True, kw_only=True)
class Block:
    """A block, as the rest sees it."""

    name: str
    """Name as in ``taccel-lab calibrate NAME``."""
    home: str
    """``__name__`` of the module that makes it."""
    words: type[BlockWords]
    needs: Callable[[CaptureFolder, bool | None], Needs]
    """Contents of a folder for it; the flag says whether images are grey, where that is known."""
    fitted_by: str
    """Its fit, ``calibrate_NAME``: (folder, base, options, progress) -> result; without options for
    a block that has none."""
    shown_by: str
    """Its page, ``NAME_page``: (result) -> page, or (result, folder) where ``reads_folder``."""
    checked_by: str = ""
    """Check of what the captures hold for it: (folder) -> findings."""
    choices: str = ""
    """Class of the fit's options; empty where there is nothing to choose."""
    reads_folder: bool = False
    """Whether the page reads images of the folder."""
    measures_scale: bool = False
    """Whether it measures the scale itself, and is given none."""
    telling: int = 0
    """Rank of its first picture: a report of several blocks opens with that of the highest."""
    key: str = ""
    """Key in a profile of the block whose evidence ``scores`` reads."""
    scores: Callable[[Residuals], Iterable[Score]] | None = None
    """Figures that a page opens with; None for a block that is not scored."""

    def _loaded(self, name: str) -> Any:
        return resolve_name(f"{self.home.rpartition('.')[0]}.{name}")

    @property
    def verb(self) -> Callable[..., BlockResult]:
        """Function that fits the block."""
        return self._loaded(self.fitted_by)

    @property
    def options(self) -> type | None:
        """Class of the fit's options; None where there is nothing to choose."""
        return self._loaded(self.choices) if self.choices else None

    def check(self, folder: CaptureFolder) -> list[Remark]:
        """Findings about what the folder holds for this block alone."""
        return self._loaded(self.checked_by)(folder) if self.checked_by else []

    def fit(
        self,
        folder: CaptureFolder,
        base: SensorProfile,
        options: Any = None,
        progress: Progress = silent,
    ) -> BlockResult:
        """The block's calibration, with its defaults where no options are given.

        Raises:
            InputError: Captures that it cannot use, or options for a block that has none.
        """
        allowed = self.options
        if allowed is None:
            if options is not None:
                raise InputError(f"the calibration of {self.name} has no options")
            return self.verb(folder, base, progress)
        if options is not None and not isinstance(options, allowed):
            raise InputError(
                f"the calibration of {self.name} takes {allowed.__name__}, "
                f"got {type(options).__name__}"
            )
        options = allowed() if options is None else options
        return self.verb(folder, base, options, progress)

    @property
    def describe(self) -> Callable[..., Page]:
        """Function that shows its result."""
        return self._loaded(self.shown_by)

    def page(self, result: BlockResult, folder: CaptureFolder) -> Page:
        """The result as a page; pictures are drawn when it is written."""
        return self.describe(result, folder) if self.reads_folder else self.describe(result)
