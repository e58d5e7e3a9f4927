# SPDX-License-Identifier: Apache-2.0
"""Where the ball presses of captures are, found once for all blocks that are fitted to them.

The training presses are explained together. The held-out ones are found each by itself, after every
figure of theirs is taken, for the fit to all presses that a profile ends with.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

from taccel_lab.calibration.capture.captures import CaptureSet, ContactCircle
from taccel_lab.calibration.contacts.fit import detect_contact
from taccel_lab.calibration.contacts.fusion import choose_circles
from taccel_lab.calibration.contacts.usable import UsableCircles, usable_circles
from taccel_lab.calibration.press_options import BallPressOptions
from taccel_lab.errors import InputError
from taccel_lab.progress import Progress, silent


@dataclass(frozen=True)
class PressCircles:
    """Circles of all presses of a split."""

    usable: UsableCircles
    """The training presses that show a contact, and their circles."""
    heldout: CaptureSet | None
    options: BallPressOptions

    @classmethod
    def of(
        cls,
        training: CaptureSet,
        heldout: CaptureSet | None,
        options: BallPressOptions,
        *,
        cache: bool = True,
        progress: Progress = silent,
    ) -> PressCircles:
        """Circles of ``training``; errors as of ``usable_circles``."""
        usable = usable_circles(training, options.circles, cache=cache, progress=progress)
        return cls(usable, heldout, options)

    @cached_property
    def of_heldout(self) -> dict[str, ContactCircle]:
        """Circles of the held-out presses by name, without those that show no contact: as those of
        the training presses are chosen, with what these say of all labels."""
        if self.heldout is None:
            return {}
        presses, contacts = [], []
        for press in self.heldout.presses:
            try:
                contact = detect_contact(
                    press.image(),
                    self.heldout.background,
                    self.heldout.grid,
                    mask=self.heldout.mask,
                    name=press.source,
                    ball_radius_mm=press.radius_mm or self.heldout.ball_radius_mm,
                    label=press.circle,
                )
            except InputError:
                continue  # The figures of the block say so.
            presses.append(press)
            contacts.append(contact)
        trained = self.usable.captures.presses
        every = replace(self.heldout, presses=(*trained, *presses))
        circles = choose_circles(
            every,
            [*self.usable.contacts, *contacts],
            self.options.circles,
            [press.name for press in trained],
        )
        own = circles[len(trained) :]
        return {press.name: circle for press, circle in zip(presses, own, strict=True)}
