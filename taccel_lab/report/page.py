# SPDX-License-Identifier: Apache-2.0
"""One page for any result: pictures and figures first, then remarks, tables, further pictures;
self-contained HTML and JSON.

Whoever has a result describes its page in these terms and draws its own figures; nothing here knows
what was found. The page embeds every figure and its one script, and loads nothing, so it can be
mailed as one file; links lead to what stands beside it.
"""

from __future__ import annotations

import base64
import functools
import io
import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec

from taccel_lab.errors import InputError
from taccel_lab.files.atomic_file import atomic_file, write_bytes, write_json
from taccel_lab.files.output_folder import atomic_directory
from taccel_lab.report.citation import CITATION
from taccel_lab.report.lead import Link, Picture, Score, Strip
from taccel_lab.report.remark import Remark, Severity, Verdict, judge
from taccel_lab.report.style import in_report_style, save_figure_to

if TYPE_CHECKING:
    from matplotlib.figure import Figure

P = ParamSpec("P")
PAGE, REPORT = "report.html", "report.json"
"""Files of a written page: itself, and its figures."""
MOST_TO_DO = 3
VERDICT_CODES = ("block_state",)
"""Codes of remarks that only repeat a block's verdict."""


@dataclass(frozen=True)
class Table:
    """Rows of cells; numbers are formatted with four significant digits, links can be followed."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    folded: bool = False
    """Whether it comes after the pictures, under its title until somebody opens it."""

    @classmethod
    def of(
        cls,
        title: str,
        items: Iterable[Any],
        columns: Mapping[str, str | Callable[[Any], Any]],
        caption: str = "",
    ) -> Table:
        """A row an item; the cells of a column are an attribute of the items, by its dotted name,
        or what a function makes of each item."""
        cells = [attrgetter(cell) if isinstance(cell, str) else cell for cell in columns.values()]
        return cls(title, tuple(columns), [[cell(i) for cell in cells] for i in items], caption)

    def shown(self) -> Table:
        """Drops columns that hold nothing."""
        keep = [
            i
            for i, name in enumerate(self.columns)
            if not name or i == 0 or any(row[i] not in (None, "", "–") for row in self.rows)
        ]
        columns = [self.columns[i] for i in keep]
        return replace(self, columns=columns, rows=[[row[i] for i in keep] for row in self.rows])


def picture(name: str, caption: str) -> Callable[[Callable[P, Figure]], Callable[P, Picture]]:
    """Declare a picture by the function that draws its figure.

    The function then gives the ``Picture``, whose figure is drawn in the report's style when the
    page is written.
    """

    def declared(draw: Callable[P, Figure]) -> Callable[P, Picture]:
        styled = in_report_style(draw)

        @functools.wraps(draw)
        def of(*args: P.args, **kwargs: P.kwargs) -> Picture:
            return Picture(name, functools.partial(styled, *args, **kwargs), caption)

        return of

    return declared


@dataclass(frozen=True)
class Page:
    """What a report says."""

    title: str
    summary: str
    """One paragraph: what was fitted to what, and how well."""
    remarks: Sequence[Remark] = ()
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    """The first one opens the page, unless ``strips`` do."""
    figures: dict[str, Any] = field(default_factory=dict)
    """Everything measured, written as JSON beside the page."""
    files: dict[str, Callable[[Path], None]] = field(default_factory=dict)
    """Other files beside the page: name, and what writes it."""
    headline: str = ""
    """Words in place of "Verdict: good"."""
    strips: Sequence[Strip] = ()
    """What was achieved, side by side, above everything else."""
    scores: Sequence[Score] = ()
    """Figures below the picture that opens the page."""
    links: Sequence[Link] = ()
    """Ways to what stands beside the page."""

    @property
    def drawn(self) -> list[Picture]:
        """All pictures, as they come on the page."""
        return [*(panel for strip in self.strips for panel in strip.panels), *self.pictures]

    @property
    def verdict(self) -> Verdict:
        """What the remarks leave."""
        return judge(self.remarks)


def first_figure(pages: Iterable[Page]) -> Figure:
    """Draw the first figure of the first page that has one.

    Raises:
        InputError: No page has a figure.
    """
    from matplotlib.figure import Figure

    for page in pages:
        for picture in page.drawn:
            if isinstance(found := picture.draw(), Figure):
                return found
    raise InputError("nothing was measured that a figure could show")


def sentence(text: str) -> str:
    """A phrase as a sentence: a capital at its beginning, a full stop at its end."""
    text = text.strip()
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", "!", "?")) else ".")


def to_do_first(remarks: Sequence[Remark]) -> tuple[list[Remark], list[Remark]]:
    """What to do first, at most ``MOST_TO_DO`` remarks, the gravest first; and the others.

    A block's own verdict is nothing to do: what it rests on is.
    """
    asked = [r for r in remarks if r.severity != Severity.INFO and r.code not in VERDICT_CODES]
    first = sorted(asked, key=lambda remark: remark.severity != Severity.ERROR)[:MOST_TO_DO]
    return first, [remark for remark in remarks if remark not in first]


def page_html(page: Page, images: Mapping[str, str]) -> str:
    """The page as HTML; ``images``: each picture as text that a page embeds, by its name."""
    to_do, others = to_do_first(page.remarks)
    judging = [remark for remark in page.remarks if remark.severity != Severity.INFO]
    opening, further = (
        ((), page.pictures) if page.strips else (page.pictures[:1], page.pictures[1:])
    )
    return (
        report_environment()
        .get_template("page.html.j2")
        .render(
            page=page,
            verdict=page.verdict,
            state="plain" if page.headline and not judging else page.verdict,
            to_do=to_do,
            others=others,
            tables=[table.shown() for table in page.tables if table.rows],
            opening=opening,
            further=further,
            images=images,
        )
    )


def page_figures(page: Page, files: Mapping[str, str]) -> dict[str, Any]:
    """What stands in ``report.json``; ``files``: each picture's file by its name."""
    remarks = [{"severity": r.severity, "code": r.code, "message": r.message} for r in page.remarks]
    pictures = [{"file": files[one.name], "caption": one.caption} for one in page.drawn]
    return {
        "title": page.title,
        "verdict": page.verdict,
        "remarks": remarks,
        "scores": [asdict(score) for score in page.scores],
        "pictures": pictures,
        **page.figures,
    }


def write_page_into(page: Page, folder: Path) -> None:
    """Write ``report.html``, ``report.json``, pictures and files into a folder that is there."""
    images, files = {}, {}
    for picture in page.drawn:
        drawn = _drawn(picture)
        files[picture.name] = f"{picture.name}{image_suffix(drawn)}"
        write_bytes(folder / files[picture.name], drawn)
        images[picture.name] = data_url(drawn)
    for name, write in page.files.items():
        write(folder / name)
    with atomic_file(folder / PAGE) as staging:
        html = page_html(page, images)
        staging.write_text(html, encoding="utf-8", errors="backslashreplace")
    write_json(folder / REPORT, page_figures(page, files))


def write_page(page: Page, folder: Path | str) -> None:
    """Write the page as the folder, whole or not at all, see ``write_page_into``.

    Raises:
        InputError: The folder holds files that taccel-lab did not write.
    """
    with atomic_directory(folder) as staging:
        write_page_into(page, staging)


def write_page_file(page: Page, path: Path | str) -> None:
    """Write the page alone, as one file."""
    images = {picture.name: data_url(_drawn(picture)) for picture in page.drawn}
    with atomic_file(path) as staging:
        html = page_html(page, images)
        staging.write_text(html, encoding="utf-8", errors="backslashreplace")


def _drawn(picture: Picture) -> bytes:
    drawn = picture.draw()
    if isinstance(drawn, bytes):
        return drawn
    file = io.BytesIO()
    save_figure_to(drawn, file)
    return file.getvalue()


def image_suffix(image: bytes) -> str:
    """How the name of a JPEG or a PNG file ends, by its first bytes."""
    return ".jpg" if image.startswith(b"\xff\xd8") else ".png"


def data_url(image: bytes) -> str:
    """A PNG or a JPEG file as text that a page embeds."""
    kind = "jpeg" if image_suffix(image) == ".jpg" else "png"
    return f"data:image/{kind};base64," + base64.b64encode(image).decode()


def report_environment() -> Any:
    """Jinja2 environment of the templates here."""
    import jinja2

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("taccel_lab.report"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.globals["citation"] = CITATION
    environment.filters["number"] = format_number
    environment.filters["breakable"] = _breakable
    environment.filters["signed"] = _signed
    return environment


def _signed(text: str) -> str:
    """A text with the sign that a terminal may lack."""
    return text.replace("+-", "±")


def _breakable(name: str) -> Any:
    """A name that may go on in another line after each of its underscores and colons."""
    import markupsafe

    text = str(markupsafe.escape(name))
    return markupsafe.Markup(re.sub(r"([_:])(?=\S)", r"\1<wbr>", text))


def format_number(value: Any) -> str:
    """A number for a table cell, with four significant digits; a dash for none."""
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return "–"
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    size = abs(value)
    if size != 0 and (size < 1e-3 or size >= 1e5):
        return f"{value:.2e}"
    return f"{value:.4g}"
