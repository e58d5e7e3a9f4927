# SPDX-License-Identifier: Apache-2.0
"""What a gel's view keeps when it is given another gel, and how often it draws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from taccel_lab.geometry.block import block_mesh
from taccel_lab.report.live_page import PageOptions, live_page
from taccel_lab.viewer.gel_states import Field, GelStates, SensorImages
from taccel_lab.viewer.gel_view import GelView

pytest.importorskip("viser", reason="the extra view is not installed")


def block_states(count: int, *labels: str) -> GelStates:
    mesh = block_mesh((2, 2, 1), (0.02, 0.02, 0.004))
    rest = 1e3 * mesh.nodes_m
    return GelStates(
        rest_mm=rest,
        tets=mesh.tets.astype(np.int64),
        faces=mesh.faces.astype(np.int64),
        moved_mm=np.zeros((count, *rest.shape)),
        captions=[f"state {k}" for k in range(count)],
        fields=[Field(label, "kPa", np.zeros((count, len(rest)))) for label in labels],
    )


def test_another_gel_is_drawn_once_and_shows_the_field_that_was_chosen_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    drawn: list[str] = []
    draw = GelView._draw
    with live_page("Views", PageOptions(port=0, browser=False)) as server:
        untouched, press = block_states(1), block_states(2, "stress", "pressure")
        view = GelView(server, press)

        def counted(self: GelView) -> None:
            drawn.append(str(self._field.value))
            draw(self)

        monkeypatch.setattr(GelView, "_draw", counted)
        view.choose(field="pressure")
        drawn.clear()
        # As on the design page: the solid of a new design, then its press.
        view.show_states(untouched)
        view.show_states(press, 1)
        assert drawn == ["displacement", "pressure"]
        assert view.time.state == 1

        # Images come without the gel being drawn again, for the state that is shown.
        shades = np.stack([np.full((4, 4, 3), shade, dtype=np.uint8) for shade in (10, 200)])
        view.show_images(SensorImages(shades))
        assert len(drawn) == 2
        assert view.sensor._image.image.max() == 200
        view.choose(state=0)
        assert view.sensor._image.image.max() == 10
        view.sensor.clear("No picture: it is dark")
        assert view.sensor._note.content == "No picture: it is dark"
        view.show_states(replace(press, images=None), 1)
        assert view.sensor._image.image.max() == 128
