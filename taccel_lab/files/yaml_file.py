# SPDX-License-Identifier: Apache-2.0
"""YAML files: keys, lists, texts and numbers, as other projects keep their settings.

Nothing else of YAML is read: no anchors and aliases (a few hundred bytes of them stand for
gigabytes), no tags, no merged or repeated keys. Words are what YAML 1.2's core schema takes them
for: ``yes``, ``1:30``, ``1_000``, ``.inf`` and dates are text.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, ClassVar

from taccel_lab.errors import InputError
from taccel_lab.files.plain_values import MAX_DEPTH, require_plain_values
from taccel_lab.files.text_file import read_text, shown

YAML_LIMIT_BYTES = 256 << 10
"""Settings of sensors have a few KiB; the parser reads some 100 KiB a second."""


def read_yaml(path: Path) -> dict[str, Any]:
    """Content of a YAML file that holds one table of keys.

    Raises InputError with the path: no file, too large, no text, no YAML or no table, what is not
    read (see above), nested too deep, numbers that are not finite or too large.
    """
    import yaml

    text = read_text(path, YAML_LIMIT_BYTES, "a YAML file")
    try:
        document = yaml.load(text, _loader())
    except RecursionError:
        raise InputError(f"{path} is nested more than {MAX_DEPTH} deep") from None
    except (yaml.YAMLError, ValueError) as error:
        cause = " ".join(str(error).split())
        raise InputError(f"{path} cannot be read as YAML: {cause}") from None
    if not isinstance(document, dict):
        raise InputError(f"{path} holds {shown(document)}; a table of keys is needed")
    return require_plain_values(document, str(path))


def _loader() -> type[Any]:
    """The loader; made here since yaml is imported late."""
    import yaml

    class Loader(yaml.SafeLoader):
        yaml_implicit_resolvers: ClassVar[dict[str, Any]] = {}

        def compose_node(self, parent: Any, index: Any) -> Any:
            event = self.peek_event()
            mark = event.start_mark
            if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
                raise yaml.MarkedYAMLError(
                    problem="anchors and aliases are not read", problem_mark=mark
                )
            if getattr(event, "tag", None) is not None:
                problem = f"tags ({shown(event.tag)}) are not read"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
            found: dict[Any, Any] = {}
            for key_node, value_node in node.value:
                problem = None
                if not isinstance(key_node, yaml.ScalarNode):
                    problem = "a list or table as a key is not read"
                elif key_node.value in found:
                    problem = f"the key {shown(key_node.value)} stands twice"
                if problem is not None:
                    mark = key_node.start_mark
                    raise yaml.MarkedYAMLError(problem=problem, problem_mark=mark)
                # Keys are text, whatever they look like.
                found[key_node.value] = self.construct_object(value_node, deep=True)
            return found

    for tag, pattern, first in (
        ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
        ("bool", r"true|True|TRUE|false|False|FALSE", list("tTfF")),
        ("int", r"[-+]?[0-9]+", list("-+0123456789")),
        (
            "float",
            r"[-+]?(?:\.[0-9]+|[0-9]+\.?[0-9]*)(?:[eE][-+]?[0-9]+)?",
            list("-+0123456789."),
        ),
    ):
        name = f"tag:yaml.org,2002:{tag}"
        Loader.add_implicit_resolver(name, re.compile(rf"(?:{pattern})\Z"), first)
    Loader.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(node.value))
    Loader.add_constructor("tag:yaml.org,2002:float", lambda _, node: float(node.value))
    return Loader
