# SPDX-License-Identifier: Apache-2.0
"""Tables of docs/studies.md are those of the code; its study file can be run."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from taccel_lab.errors import InputError
from taccel_lab.studies.describe import press_in_words, with_tables
from taccel_lab.studies.presses import STANDARD_PRESSES
from taccel_lab.studies.spec import StudySpec, spec_of
from taccel_lab.studies.study import default_kit, make_study

PAGE = Path(__file__).parents[2] / "docs" / "studies.md"


def test_tables_are_up_to_date() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert with_tables(text) == text, "run: python -m taccel_lab.studies.describe docs/studies.md"


def test_pages_without_places_for_tables_are_refused() -> None:
    with pytest.raises(InputError, match="begin metrics"):
        with_tables("# empty\n")


def test_the_study_file_of_the_page_is_sound() -> None:
    block, *_ = re.findall(r"```toml\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    assert len(make_study(spec_of(tomllib.loads(block)), default_kit()).points()) == 32


def test_every_key_is_described() -> None:
    text = PAGE.read_text(encoding="utf-8")
    reference = text[text.index("| key |") : text.index("## Presses")]
    for table, field in StudySpec.model_fields.items():
        assert f"`{table}" in reference, table
        model = field.annotation
        if table in ("study", "sweep", "output", "run"):
            for key in model.model_fields:  # type: ignore[union-attr]
                assert f"`{table}.{key}`" in reference or f"`.{key}`" in reference, (table, key)


def test_presses_in_words() -> None:
    words = press_in_words(STANDARD_PRESSES["shear"])
    assert "sideways by" in words and "and back" in words and "turned by" in words
    assert "in 5 places" in press_in_words(STANDARD_PRESSES["places"])
    assert "up again" in press_in_words(STANDARD_PRESSES["release"])
