# SPDX-License-Identifier: Apache-2.0
"""The design page: sliders on the left, the sensor in the middle, what it does on the right."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.report.live_page import PageOptions, live_page, viser_module
from taccel_lab.report.page_text import PageText, add_html_note, add_note
from taccel_lab.scene import sphere_mesh
from taccel_lab.sensors.base import all_optics
from taccel_lab.viewer.background_press import NewestFirst
from taccel_lab.viewer.ball_press import (
    BallPress,
    PressAnswer,
    SupersededError,
    height_profile_mm,
)
from taccel_lab.viewer.design_answer import (
    PICTURES,
    Choice,
    DesignAnswer,
    DesignAnswers,
    force_table,
    heading,
    quality_table,
    stage_words,
    stiffness_words,
)
from taccel_lab.viewer.design_controls import DesignControls, History
from taccel_lab.viewer.design_export import EXPORTS, TOML, command_line, export, packed
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages, ShownTool
from taccel_lab.viewer.gel_view import GelView
from taccel_lab.viewer.page_parts import SensorPanel, look_at
from taccel_lab.viewer.profile_page import draw_optics

if TYPE_CHECKING:
    from viser import ViserServer

    from taccel_lab.sensors.base import SensorFamily


MODULUS = "young_modulus_mpa"
PRESS, SOLID = "press", "solid"
"""What may be shown in the middle."""
BLANK = np.full((4, 4, 3), 255, dtype=np.uint8)
NO_HEIGHTS = (np.array([0.0, 1.0]), np.zeros(2), np.zeros(2))
WIDE_MODAL = PageText("<style>.mantine-Modal-content { flex: 0 0 min(95vw, 100vh); }</style>")
"""Style of modals as wide as an A4 sheet fits the page: viser's are hardly wider than its panels,
and have no width to set."""


@contextmanager
def design_page(
    family: SensorFamily,
    overrides: Mapping[str, Any],
    out: Path,
    options: PageOptions,
    say: Callable[[str], None] | None = None,
) -> Iterator[DesignPage]:
    """The page of a family while the block runs; exports go below ``out``.

    Raises InputError as of ``live_page``, or for parameters that the family refuses.
    """
    answers = DesignAnswers(family)
    try:
        answers.begin(Choice(overrides))
        with live_page(f"Design: {family.name}", options, say) as server:
            page = DesignPage(server, answers, overrides, out)
            try:
                yield page
            finally:
                page.work.close()
    finally:
        answers.close()


class DesignPage:
    """Controls, the work behind them, and what is shown of its answers."""

    def __init__(
        self, server: ViserServer, answers: DesignAnswers, overrides: Mapping[str, Any], out: Path
    ) -> None:
        self._server, self._family, self._out = server, answers.family, out
        self._answers = answers
        self._moved = ""
        self._stepping = False
        """Whether undo or redo is setting the controls."""
        self._written: list[Path] = []
        """Files of the last export."""
        self._exporting = threading.Lock()
        self.shown: DesignAnswer | None = None
        """What the page shows now."""
        self._build(overrides)
        self._history = History(self._choice())
        self.work: NewestFirst[Choice] = NewestFirst(self._work)
        self._ask()

    # The page --------------------------------------------------------------------------------

    def _build(self, overrides: Mapping[str, Any]) -> None:
        gui = self._server.gui
        left = gui.add_panel()
        with left.add_tab("Parameters"):
            self._heading = add_note(gui)
            buttons = gui.add_button_group("", ("Undo", "Redo", "Reset"))
            buttons.on_click(lambda event: self.go(event.target.value))
            self.controls = DesignControls(self._server, self._family, overrides, self._change)
        left.dock_left()
        left.set_width(320)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Result"):
            self._status = add_note(gui)
            self._middle = gui.add_dropdown(
                "in the middle", (PRESS, SOLID),
                hint="The press has another mesh, fine around the ball and coarse at the rim.",
            )  # fmt: skip
            with gui.add_folder("Press of a ball"):
                self._radius = gui.add_slider("radius [mm]", 1.0, 8.0, 0.1, 3.0)
                self._depth = gui.add_slider("depth [mm]", 0.1, 2.0, 0.05, 0.5)
                self._force = add_note(gui)
                add_note(gui, "Height along the middle of the gel: grey untouched, blue pressed.")
                self._plot = self._add_plot()
            with gui.add_folder("What the camera sees"):
                self._sensor = SensorPanel(
                    self._server, single="Of the untouched gel.", own_panel=False
                )
            with gui.add_folder("Mesh"):
                self._quality = add_note(gui)
        with tabs.add_tab("Drawing"):
            self._drawing_note = add_note(gui)
            self._drawing = gui.add_image(BLANK, format="png")
            gui.add_button("Enlarge", color="gray").on_click(self._enlarge)
        with tabs.add_tab("Look"):
            pad = self._family.parameters(overrides).pad()
            states = GelStates.untouched(self._answers.mesh(pad))
            self._view = GelView(self._server, states, self._sensor)
        with tabs.add_tab("Export"):
            add_note(gui, f"Files go to {self._out}.")
            for kind in (*EXPORTS, TOML):
                gui.add_button(kind, color="gray").on_click(lambda _, kind=kind: self.export(kind))
            self._exported = add_note(gui)
            self._download = gui.add_button("Download what was written", visible=False)
            self._download.on_click(self._send)
            add_note(gui, "The same without this page:")
            self._command = gui.add_text("command", "", multiline=True)
        look_at(self._server, states.rest_mm, distance=2.2)
        for control in (self._radius, self._depth):
            control.on_update(lambda event: self._change(event.target.label))
        self._middle.on_update(lambda _: self._draw())

    def _add_plot(self) -> Any:
        uplot = viser_module().uplot
        axis = {"stroke": "#6b7280"}
        return self._server.gui.add_uplot(
            NO_HEIGHTS,
            (
                uplot.Series(label="x [mm]"),
                uplot.Series(label="untouched: z [mm]", stroke="#9ca3af", width=1),
                uplot.Series(label="pressed: z [mm]", stroke="#0072b2", width=2),
            ),
            scales={"x": uplot.Scale(time=False)},
            axes=(uplot.Axis(label="x [mm]", **axis), uplot.Axis(label="z [mm]", **axis)),
            aspect=1.5,
            padding=(14, 10, 0, 0),
            legend=uplot.Legend(show=False),
        )

    # Changes and answers ---------------------------------------------------------------------

    def go(self, button: str) -> None:
        """Acts as the buttons do: Undo, Redo, Reset."""
        if button == "Reset":
            self.controls.set_all({})
            return
        choice = self._history.step(-1 if button == "Undo" else 1)
        if choice is None:
            return
        self._stepping = True
        self._radius.value, self._depth.value = choice.press.radius_mm, choice.press.depth_mm
        self.controls.set_all(choice.overrides)
        self._stepping = False
        self._ask()

    def _change(self, name: str) -> None:
        if self._stepping:
            return
        self._moved = name or self._moved
        self._history.add(self._choice(), name)
        self._ask()

    def _choice(self) -> Choice:
        press = BallPress(float(self._radius.value), float(self._depth.value))
        return Choice(self.controls.overrides(), press)

    def _ask(self) -> None:
        choice = self._choice()
        self._command.value = command_line(self._family, choice.overrides, self._out)
        self.work.ask(choice)

    def _work(self, choice: Choice, superseded: Callable[[], bool]) -> None:
        """Answers one choice, as far as it is still wanted; in the thread of the work."""
        try:
            self._status.content = PageText("*working …*")
            self._answers.answer(choice, self._tell, superseded)
        except SupersededError:
            return
        except InputError as error:
            self._refuse(str(error))
            self._status.content = PageText("**Rejected:** {}").format(error)
        except Exception as fault:
            # The thread must live: without it the page would never answer again.
            traceback.print_exc()
            self._status.content = PageText(
                "**Internal error:** {!r}. The terminal shows the traceback; other values may work."
            ).format(fault)

    def _refuse(self, words: str) -> None:
        """Put a refusal beside the controls that it names."""
        self.controls.refuse(words.removeprefix(f"sensor {self._family.name}: "), self._moved)

    def _tell(self, piece: str, answer: DesignAnswer) -> None:
        """A piece of an answer is there, or is known not to come; "step": how far the press is."""
        self.shown = answer
        self._status.content = stage_words(answer)
        self._force.content = force_table(answer)
        if piece in answer.failed:
            self._refuse(answer.failed[piece])
        press = answer.exact or answer.quick
        if piece == "formula":
            self.controls.accept()
            self._heading.content = heading(self._family.label, answer.parameters)
            stiffness = stiffness_words(answer.parameters)
            if stiffness and MODULUS in answer.parameters.values():
                self.controls.remark(MODULUS, stiffness)
            self._drawing_note.content = PageText("*of the design before; drawing the new one …*")
        elif piece == "solid":
            assert answer.mesh is not None
            self._draw()
            self._quality.content = quality_table(answer)
            seen = all_optics(answer.parameters)
            if seen:
                design, further = seen[0], [one.camera for one in seen[1:]]
                back = 1e3 * float(answer.mesh.nodes_m[:, 2].min())
                draw_optics(self._server, design, back, None, further)
        elif piece == "drawing":
            self._drawing_note.content = answer.failed.get(piece, "")
            self._drawing.image = BLANK if answer.drawing_rgb is None else answer.drawing_rgb
        elif piece in PICTURES:
            self._view.show_images(_images(answer))
            if answer.rest_rgb is None:
                self._sensor.clear(f"No picture: {answer.failed.get('rest', '')}")
        elif piece in ("quick", "exact"):
            self._draw()
            if press is None:
                self._plot.data = NO_HEIGHTS
                return
            x, z = height_profile_mm(press, press.positions_m)
            rest_x, rest_z = height_profile_mm(press, press.mesh.nodes_m)
            self._plot.data = (x, np.interp(x, rest_x, rest_z), z)

    def _draw(self) -> None:
        """The gel in the middle of the page."""
        answer = self.shown
        if answer is None:
            return
        press = answer.exact or answer.quick
        if press is not None and self._middle.value == PRESS:
            self._view.show_states(_states(press, answer), 1)
        elif answer.mesh is not None:
            self._view.show_states(GelStates.untouched(answer.mesh, _images(answer)))

    def _enlarge(self, event: Any) -> None:
        """Enlarges in the browser that asked for it; other ones go on as they were."""
        if self.shown is None or self.shown.drawing_rgb is None or event.client is None:
            return
        gui = event.client.gui
        with gui.add_modal("Drawing of the gel") as modal:
            add_html_note(gui, WIDE_MODAL)
            gui.add_image(self.shown.drawing_rgb, format="png")
            gui.add_button("Close").on_click(lambda _: modal.close())

    def export(self, kind: str) -> None:
        """Write files, as the buttons do."""
        with self._exporting:
            self._exported.content = PageText("*writing {} …*").format(kind)
            try:
                files = export(kind, self._family, self.controls.overrides(), self._out)
            except (InputError, OSError) as error:
                self._exported.content = PageText("**Not written:** {}").format(error)
                return
            # Below the folder that is named above: whole paths would break over lines.
            self._exported.content = PageText("\n").join(
                PageText("- {}").format(path.relative_to(self._out)) for path in files.values()
            )
            self._written = list(files.values())
            self._download.visible = True

    def _send(self, event: Any) -> None:
        """Send the last export to the browser that asked for it."""
        if event.client is not None:
            name, content = packed(self._written, self._out)
            event.client.send_file_download(name, content, save_immediately=True)


def _states(press: PressAnswer, answer: DesignAnswer) -> GelStates:
    """Untouched and pressed, with loads, ball and pictures."""
    ball = answer.press.radius_mm
    sphere = sphere_mesh(1e-3 * ball, 1e-3 * ball / 10)
    above = press.ball_mm + [0, 0, answer.press.depth_mm + 0.3]
    turn = np.array([0.0, 0.0, 0.0, 1.0])
    base = GelStates.untouched(press.mesh)
    moved = 1e3 * press.positions_m - base.rest_mm

    def twice(values: np.ndarray) -> np.ndarray:
        return np.stack([np.zeros_like(values), values])

    return replace(
        base,
        moved_mm=twice(moved),
        captions=["untouched", f"{answer.press.depth_mm:.2f} mm deep, {press.force_n:.3f} N"],
        fields=[
            Field("von Mises stress", "kPa", 1e-3 * twice(press.von_mises_pa)),
            Field("contact pressure", "kPa", 1e-3 * twice(press.pressures_pa)),
        ],
        forces_n=twice(press.forces_n),
        tool=ShownTool(
            1e3 * sphere.vertices_m,
            sphere.faces,
            np.stack([np.concatenate([above, turn]), np.concatenate([press.ball_mm, turn])]),
        ),
        images=_images(answer),
    )


def _images(answer: DesignAnswer) -> SensorImages | None:
    """Untouched and pressed, as far as they are there."""
    found = [one for one in (answer.rest_rgb, answer.pressed_rgb) if one is not None]
    return SensorImages(np.stack(found)) if found else None
