# SPDX-License-Identifier: Apache-2.0
"""What a design page says of a design, piece by piece in the order in which it is known."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.cad.mesh.gel_mesh import SoundMesh, is_formula, kept_mesh, sound_gel_mesh
from taccel_lab.cad.mesh.quality import MeshQuality, QualityGate, check_quality
from taccel_lab.cad.parts.pad import Pad
from taccel_lab.errors import InputError, SimulationError
from taccel_lab.geometry import TetMesh
from taccel_lab.processes.start_warp import start_warp
from taccel_lab.report.page_text import PageText, page_table
from taccel_lab.sensors.base import hardness_of
from taccel_lab.sensors.derived import pad_words, size_words
from taccel_lab.viewer.background_press import BackgroundPress
from taccel_lab.viewer.ball_press import (
    BallPress,
    PressAnswer,
    SupersededError,
    formula_force_n,
    kept_press,
    scaled,
)

if TYPE_CHECKING:
    from taccel_lab.files.file_cache import CachedFile
    from taccel_lab.sensors.base import FamilyParameters, SensorFamily


PIECES = ("formula", "solid", "quick", "rest", "pressed", "drawing", "exact")
"""Pieces of an answer, in the order in which they are begun; the last one is worked on beside all
others, so that it may come before some of them."""
PICTURES = ("rest", "pressed")
PICTURE_PX = 240
"""Longer side of the pictures of the page."""
DRAWING_PX = 1400
"""Width of the drawing."""
_KEPT = 16
"""Meshes, presses and pictures that are kept, so that sliders may go back and forth."""


@dataclass(frozen=True)
class Choice:
    """What the sliders say."""

    overrides: Mapping[str, Any]
    press: BallPress = field(default_factory=BallPress)


@dataclass
class DesignAnswer:
    """Filled piece by piece; ``seconds`` has when each was known, since the change."""

    parameters: FamilyParameters
    press: BallPress
    """Press no deeper than the gel allows."""
    formula_n: float = math.nan
    mesh: TetMesh | None = None
    quick: PressAnswer | None = None
    quality: MeshQuality | None = None
    refused: list[str] = field(default_factory=list)
    """Limits that the mesh breaks."""
    rest_rgb: np.ndarray | None = None
    pressed_rgb: np.ndarray | None = None
    drawing_rgb: np.ndarray | None = None
    exact: PressAnswer | None = None
    exact_steps: tuple[int, int] = (0, 0)
    """Steps of the default press that are done, and how many it has; none before the first."""
    failed: dict[str, str] = field(default_factory=dict)
    """Pieces that this design does not have, and why, in words."""
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def missing(self) -> list[str]:
        """Pieces that are not known yet."""
        blind = self.parameters.optics() is None
        return [
            one for one in PIECES if one not in self.seconds and not (blind and one in PICTURES)
        ]


class DesignAnswers:
    """Answers of one family; keeps what later answers can take over. ``close`` ends its process."""

    def __init__(self, family: SensorFamily) -> None:
        self.family = family
        self._catalogue = self._empty(Choice({}))
        self._meshes = lru_cache(_KEPT)(self._sound_mesh)
        self._drawings = lru_cache(_KEPT)(_drawing)
        self._presses: dict[Any, tuple[float, PressAnswer]] = {}
        self._pictures: dict[Any, np.ndarray] = {}
        self._beside = BackgroundPress()
        self._begun: tuple[Any, float] | None = None
        """Key and modulus of the press that is under way beside this."""

    def begin(self, choice: Choice) -> None:
        """Have the default press of a design simulated beside this, before its answer is wanted.

        Raises InputError as of ``answer``.
        """
        self._begin_exact(self._empty(choice))

    def mesh(self, pad: Pad) -> TetMesh:
        """The mesh of a gel as designed. Raises InputError where there is none."""
        return self._meshes(pad)[0]

    def close(self) -> None:
        """End what is under way beside; no answer may be under way here."""
        self._beside.close()

    def answer(
        self,
        choice: Choice,
        on_piece: Callable[[str, DesignAnswer], None],
        superseded: Callable[[], bool] = lambda: False,
    ) -> DesignAnswer:
        """Work out everything; ``on_piece(piece, answer)`` is called when a piece is there, or is
        known to have ``failed``, and with "step" when the default press got on.

        Raises:
            SupersededError: ``superseded`` said so between two pieces, or two steps of a press.
            InputError: Parameters that the family refuses, in its own words, or no mesh of the gel.
        """
        began = time.perf_counter()
        found = self._empty(choice)
        parameters, pad = found.parameters, found.parameters.pad()
        self._begin_exact(found)

        def tell(piece: str) -> None:
            found.seconds[piece] = time.perf_counter() - began
            on_piece(piece, found)
            if superseded():
                raise SupersededError

        def look(wait_s: float = 0.0) -> None:
            if "exact" in found.seconds:
                return
            try:
                found.exact = self._exact(found, wait_s)
            except (InputError, SimulationError) as error:
                found.failed["exact"] = str(error)
            if found.exact is not None or "exact" in found.failed:
                tell("exact")
            elif found.exact_steps != self._beside.steps:
                found.exact_steps = self._beside.steps
                on_piece("step", found)

        def find(piece: str, work: Callable[[], None]) -> None:
            try:
                work()
            except (InputError, SimulationError) as error:
                # The others do without it.
                found.failed[piece] = str(error)
            tell(piece)
            look()

        def quick() -> None:
            found.quick = self._quick(found, superseded)

        def rest() -> None:
            found.rest_rgb = self._picture(found, None)

        def pressed() -> None:
            found.pressed_rgb = None if found.quick is None else self._picture(found, found.quick)

        def drawing() -> None:
            found.drawing_rgb = self._drawings(self.family.name, pad)

        found.formula_n = formula_force_n(parameters, found.press)
        tell("formula")
        look()
        found.mesh, found.quality, edge_mm = self._meshes(pad)
        checked = check_quality(found.mesh, found.quality, QualityGate().at_edge(edge_mm))
        found.refused = [violation.text for violation in checked.violations]
        tell("solid")
        find("quick", quick)
        if parameters.optics() is not None:
            find("rest", rest)
            find("pressed", pressed)
        find("drawing", drawing)
        while "exact" not in found.seconds:
            look(0.05)
            if superseded():
                raise SupersededError
        return found

    def _sound_mesh(self, pad: Pad) -> SoundMesh:
        """Mesh as ``taccel-lab design`` writes it; the catalogue's comes from an earlier run."""
        if pad == self._catalogue.parameters.pad():
            return kept_mesh(pad, sound_gel_mesh)
        return sound_gel_mesh(pad)

    def _empty(self, choice: Choice) -> DesignAnswer:
        parameters = self.family.parameters(choice.overrides)
        return DesignAnswer(parameters, choice.press.limited(parameters.pad().thickness_mm))

    def _begin_exact(self, answer: DesignAnswer) -> None:
        """Have the default press simulated beside this, unless it is known or under way.

        That of the catalogue too where an earlier run kept it: the solver is loaded with it, for
        the first change.
        """
        key, modulus = _press_key(answer, False)
        if key in self._presses or (self._begun is not None and self._begun[0] == key):
            return
        if (file := self._kept_file(answer)) is not None and (kept := file.read()) is not None:
            self._presses[key] = modulus, kept
        self._begun = key, modulus
        self._beside.begin(answer.parameters, answer.press)

    def _kept_file(self, answer: DesignAnswer) -> CachedFile[PressAnswer] | None:
        """Where the default press of the catalogue's design is kept, None of other designs."""
        key = _press_key(answer, False)
        if key != _press_key(self._catalogue, False) or not is_formula(answer.parameters.pad()):
            return None
        with suppress(InputError):  # Nor is there a home folder everywhere.
            file = kept_press(key)
            file.path  # noqa: B018
            return file
        return None

    def _exact(self, answer: DesignAnswer, wait_s: float) -> PressAnswer | None:
        """The default press, if it is there or comes within a time."""
        key, modulus = _press_key(answer, False)
        if key not in self._presses:
            assert self._begun is not None and self._begun[0] == key
            try:
                made = self._beside.poll(wait_s)
            except (InputError, SimulationError):
                self._begun = None
                raise
            if made is None:
                return None
            _keep(self._presses, key, (self._begun[1], made))
            self._begun = None
            if (file := self._kept_file(answer)) is not None:
                with suppress(InputError):  # A cache that cannot be written keeps nothing.
                    file.write(made)
        known, made = self._presses[key]
        return scaled(made, modulus / known)

    def _quick(self, answer: DesignAnswer, superseded: Callable[[], bool]) -> PressAnswer:
        """The coarse press, simulated unless it is known."""
        # The solver takes as long to load as all else of a page, which is there before it.
        start_warp()
        from taccel_lab.viewer.design_press import press_ball

        key, modulus = _press_key(answer, True)
        if key not in self._presses:
            made = press_ball(answer.parameters, answer.press, quick=True, superseded=superseded)
            _keep(self._presses, key, (modulus, made))
        known, made = self._presses[key]
        return scaled(made, modulus / known)

    def _picture(self, answer: DesignAnswer, press: PressAnswer | None) -> np.ndarray:
        """What the camera sees, uint8 [height, width, 3], of the untouched gel or of a press."""
        start_warp()
        from taccel_lab.optics.render import OpticalModel

        design, markers = answer.parameters.optics(), answer.parameters.markers()
        assert design is not None and answer.mesh is not None
        pad = repr(answer.parameters.pad())
        # A press shapes the picture by its positions, which moduli together do not change.
        shape = None if press is None else press.positions_m.tobytes()
        key = (pad, repr(design), repr(markers), shape)
        if key not in self._pictures:
            mesh = answer.mesh if press is None else press.mesh
            size = design.camera.size_within(PICTURE_PX)
            model = OpticalModel(design, mesh, size_px=size, markers=markers)
            rgb = model.rest_rgb if press is None else model.render(press.positions_m).rgb
            _keep(self._pictures, key, rgb)
        return self._pictures[key]


def _press_key(answer: DesignAnswer, quick: bool) -> tuple[Any, float]:
    """What a press depends on besides its modulus [Pa], and that: presses whose moduli differ by a
    factor are each other's times that factor."""
    layers = answer.parameters.layer_materials()
    modulus = layers[0].young_modulus_pa
    shape = tuple(
        replace(one, young_modulus_pa=one.young_modulus_pa / modulus, young_interval_pa=None)
        for one in layers
    )
    return (repr(answer.parameters.pad()), shape, answer.press, quick), modulus


def _keep(kept: dict[Any, Any], key: Any, value: Any) -> None:
    """Add a value; the oldest goes."""
    kept[key] = value
    while len(kept) > _KEPT:
        del kept[next(iter(kept))]


def _drawing(name: str, pad: Pad) -> np.ndarray:
    """The dimensioned drawing of the gel, uint8 [height, width, 3]."""
    from taccel_lab.cad.drawing.pad_drawing import pad_drawing
    from taccel_lab.cad.parts.pad_solid import labelled_solid

    return pad_drawing(labelled_solid(pad), title=f"{name}: gel").picture(DRAWING_PX)


FORMULA_PERCENT, QUICK_PERCENT = 24, 14
"""Largest difference from the default press that was measured, see docs/viewer.md."""


_WORDS = {
    "formula": "formula",
    "solid": "solid",
    "quick": "coarse press",
    "rest": "picture",
    "pressed": "picture of the press",
    "drawing": "drawing",
    "exact": "press at default accuracy",
}
"""Words for ``PIECES``."""


def heading(label: str, parameters: FamilyParameters) -> PageText:
    """Sensor, gel and image of the design."""
    pad, grid = parameters.pad(), parameters.grid()
    return PageText("**{}**: {} {} mm, {:.4g} mm thick; image {} x {} px").format(
        label, pad_words(pad), size_words(pad), pad.thickness_mm, grid.width_px, grid.height_px
    )


def stiffness_words(parameters: FamilyParameters) -> str:
    """The modulus that a hardness stands for, as it overrides the one given; empty without."""
    hardness, gel = hardness_of(parameters.values()), parameters.material()
    if hardness is None:
        return ""
    words = parameters.parameters()[hardness].worded(parameters.values()[hardness])
    between = ""
    if gel.young_interval_pa is not None:
        low, high = (1e-6 * value for value in gel.young_interval_pa)
        between = f" ({low:.3g} to {high:.3g})"
    return f"Overridden by {words}: {1e-6 * gel.young_modulus_pa:.3g} MPa{between}."


def stage_words(answer: DesignAnswer) -> PageText:
    """What is missing, since when all is there, and what this design does not have."""
    at = max(answer.seconds.values(), default=0.0)
    missing = answer.missing
    failed = PageText("**No {}:** {}")
    lines = [failed.format(_WORDS[piece], why) for piece, why in answer.failed.items()]
    if missing:
        words = " and ".join(_next(answer, missing))
        lines.insert(0, PageText("*Next: {} … ({:.1f} s)*").format(words, at))
    else:
        lines.insert(0, PageText("**Done** {:.1f} s after the change.").format(at))
    return PageText("\n\n").join(lines)


def _next(answer: DesignAnswer, missing: list[str]) -> list[str]:
    """What is worked on: one piece after the other, the default press beside them."""
    words = [_WORDS[missing[0]]]
    if missing[-1] == "exact":
        done, steps = answer.exact_steps
        where = f" (step {done + 1} of {steps})" if steps else ""
        words = [*words, _WORDS["exact"] + where][-2 if len(missing) > 1 else -1 :]
    return words


def force_table(answer: DesignAnswer) -> PageText:
    """The force three times: by the formula, quickly, and as ``press`` by default."""
    press = answer.press
    rows = []
    if not math.isnan(answer.formula_n):
        rows.append(("formula", "formula", answer.formula_n, f"± {FORMULA_PERCENT} %"))
    for name, piece, made in (
        ("coarse", "quick", answer.quick),
        ("default", "exact", answer.exact),
    ):
        if made is not None:
            share = 100 * made.error_n / max(made.force_n, 1e-12)
            within = f"± {QUICK_PERCENT} %" if piece == "quick" else f"± {share:.1f} %"
            rows.append((name, piece, made.force_n, within))
        else:
            rows.append((name, piece, math.nan, ""))
    lines = []
    for name, piece, force, within in rows:
        if not math.isnan(force):
            cells = f"{force:.4g} N | {within} | {answer.seconds.get(piece, 0.0):.1f} s"
        elif piece in answer.failed:
            cells = "none | | "
        else:
            done, steps = answer.exact_steps if piece == "exact" else (0, 0)
            cells = "… | | " + (f"step {done + 1} of {steps}" if steps else "")
        lines.append(f"| {name} | {cells} |")
    head = f"Ball of {press.radius_mm:g} mm, **{press.depth_mm:.2f} mm** deep:"
    head_of = ["| by | force | within | after |", "|---|---|---|---|"]
    return PageText("\n".join([head, "", *head_of, *lines]))  # All of it numbers and our words.


def quality_table(answer: DesignAnswer) -> PageText:
    """Figures of the mesh, and the limits that it breaks."""
    quality = answer.quality
    if quality is None:
        return PageText()
    rows = [
        ("nodes", f"{quality.node_count:,}"),
        ("tets", f"{quality.tet_count:,}"),
        ("smallest dihedral angle", f"{quality.min_dihedral_deg:.1f} deg"),
        ("its first percentile", f"{quality.p1_dihedral_deg:.1f} deg"),
        ("mean ratio, mean", f"{quality.mean_mean_ratio:.3f}"),
    ]
    table = page_table(rows, ("mesh", ""))
    if answer.refused:
        table += PageText("\n\n**Unfit:** {}").format("; ".join(answer.refused))
    return table
