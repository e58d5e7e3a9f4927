# SPDX-License-Identifier: Apache-2.0
"""STEP files in which a box stands a great many times."""

from __future__ import annotations

import re
from pathlib import Path

from tests.files.bombs.readers import Make


def step_of_copies(levels: int, width: int) -> Make:
    """Assemblies of ``width`` assemblies each, ``levels`` deep, down to a box."""

    def make(folder: Path) -> Path:
        from build123d import Solid, export_step

        path = folder / "a.step"
        export_step(Solid.make_box(1.0, 1.0, 1.0), path)
        text = path.read_text()
        number = 100_000

        def add(entity: str) -> int:
            nonlocal number, text
            number += 1
            text = text.replace("ENDSEC;\nEND-ISO", f"#{number} = {entity};\nENDSEC;\nEND-ISO")
            return number

        product = int(re.findall(r"#(\d+) = PRODUCT_DEFINITION\(", text)[0])
        body = int(re.findall(r"#(\d+) = ADVANCED_BREP_SHAPE_REPRESENTATION", text)[0])
        (context,) = re.findall(rf"#{body} = \w+\('\w*',\([^)]*\),#(\d+)", text)
        at = int(re.findall(r"#(\d+) = AXIS2_PLACEMENT_3D", text)[0])
        for level in range(levels):
            name = f"level {level}"
            about = add(f"PRODUCT('{name}','{name}','',({_context(text)}))")
            formation = add(f"PRODUCT_DEFINITION_FORMATION('','',#{about})")
            whole = add(f"PRODUCT_DEFINITION('design','',#{formation},{_definition(text)})")
            shape = add(f"PRODUCT_DEFINITION_SHAPE('','',#{whole})")
            rep = add(f"SHAPE_REPRESENTATION('',(#{at}),#{context})")
            add(f"SHAPE_DEFINITION_REPRESENTATION(#{shape},#{rep})")
            move = add(f"ITEM_DEFINED_TRANSFORMATION('','',#{at},#{at})")
            lines = []
            for k in range(width):
                used = number + 4 * k + 1
                lines.append(
                    f"#{used} = NEXT_ASSEMBLY_USAGE_OCCURRENCE('{k}','','',#{whole},#{product},$)"
                    ";\n"
                    f"#{used + 1} = PRODUCT_DEFINITION_SHAPE('Placement','',#{used});\n"
                    f"#{used + 2} = ( REPRESENTATION_RELATIONSHIP('','',#{body},#{rep}) "
                    f"REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION(#{move}) "
                    "SHAPE_REPRESENTATION_RELATIONSHIP() );\n#"
                    f"{used + 3} = CONTEXT_DEPENDENT_SHAPE_REPRESENTATION(#{used + 2},#{used + 1})"
                    ";\n"
                )
            text = text.replace("ENDSEC;\nEND-ISO", "".join(lines) + "ENDSEC;\nEND-ISO")
            number += 4 * width
            product, body = whole, rep
        path.write_text(text)
        return path

    return make


def _context(text: str) -> str:
    return re.findall(r"(#\d+) = PRODUCT_CONTEXT", text)[0]


def _definition(text: str) -> str:
    return re.findall(r"(#\d+) = PRODUCT_DEFINITION_CONTEXT", text)[0]
