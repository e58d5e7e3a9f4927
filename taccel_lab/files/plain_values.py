# SPDX-License-Identifier: Apache-2.0
"""Values as JSON with arrays beside it: what a process that met a stranger's file may send.

A pickle runs what it names where it is loaded. Here nothing is made but numbers, texts, arrays,
lists of them, and records of the classes that the receiver names.
"""

from __future__ import annotations

import builtins
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from taccel_lab.errors import InputError
from taccel_lab.printable import words_of

_KINDS = "biufcSU"
"""Kinds of numbers and texts of arrays; an object would be a pickle again."""


def to_json(value: Any) -> tuple[str, list[np.ndarray]]:
    """JSON text of a value, and the arrays that it leaves out, each in C order.

    Raises TypeError for what is neither a number, text, path, array, container of such, record
    (dataclass, named tuple, model of pydantic, enumeration) nor exception.
    """
    arrays: list[np.ndarray] = []
    return json.dumps(_packed(value, arrays)), arrays


def from_json(text: str, buffers: Iterator[np.ndarray], records: Iterable[type] = ()) -> Any:
    """The value of ``to_json``.

    Args:
        text: The JSON text.
        buffers: Bytes of its arrays in turn, uint8.
        records: Classes that may be made.

    Raises ValueError, TypeError or LookupError for anything else.
    """
    return _unpacked(json.loads(text), buffers, {_name(record): record for record in records})


def _name(of: type) -> str:
    return f"{of.__module__}.{of.__qualname__}"


def _packed(value: Any, arrays: list[np.ndarray]) -> Any:
    if isinstance(value, (np.ndarray, np.generic)):
        array = np.asarray(value, order="C")
        if array.dtype.kind not in _KINDS:
            raise TypeError(f"an array of {array.dtype} cannot be sent")
        arrays.append(array)
        return {"array": [array.dtype.str, *array.shape], "single": isinstance(value, np.generic)}
    if isinstance(value, Enum):
        return {"enum": _name(type(value)), "value": _packed(value.value, arrays)}
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, bytes):
        arrays.append(np.frombuffer(value, np.uint8))
        return {"bytes": len(value)}
    if isinstance(value, Path):
        return {"path": str(value)}
    if isinstance(value, Mapping):
        rows = [[_packed(key, arrays), _packed(one, arrays)] for key, one in value.items()]
        return {"mapping": rows}
    if isinstance(value, list):
        return [_packed(one, arrays) for one in value]
    if isinstance(value, BaseException):
        return _packed_error(value)
    if (state := _state(value)) is not None:
        return {"record": _name(type(value)), "state": _packed(state, arrays)}
    if isinstance(value, tuple):
        return {"tuple": [_packed(one, arrays) for one in value]}
    raise TypeError(f"a {type(value).__name__} cannot be sent")


def _state(value: Any) -> Any:
    """What a record is made of; None for what is none."""
    if "__getstate__" in vars(type(value)):
        return value.__getstate__()
    if is_dataclass(value):
        return {field.name: getattr(value, field.name) for field in fields(value)}
    if hasattr(value, "_asdict"):
        return value._asdict()
    given = getattr(value, "model_fields_set", None)
    return None if given is None else {name: getattr(value, name) for name in given}


def _packed_error(error: BaseException) -> Any:
    """Kind and words of an error; a kind that is neither Python's own nor ours becomes words."""
    kind, given = type(error), [*error.args]
    if isinstance(error, OSError) and error.filename is not None:
        given.append(str(error.filename))
    known = kind is InputError or getattr(builtins, kind.__name__, None) is kind
    if not known or not all(isinstance(one, (str, int, float)) for one in given):
        kind, given = RuntimeError, [f"{kind.__name__}: {words_of(error)}"]
    notes = [str(note) for note in getattr(error, "__notes__", ())]
    return {"error": kind.__name__, "given": given, "notes": notes}


def _unpacked(value: Any, buffers: Iterator[np.ndarray], records: Mapping[str, type]) -> Any:
    if isinstance(value, list):
        return [_unpacked(one, buffers, records) for one in value]
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return _array(value["array"], bool(value["single"]), next(buffers))
    if "enum" in value:
        return records[value["enum"]](_unpacked(value["value"], buffers, records))
    if "bytes" in value:
        return next(buffers).tobytes()
    if "path" in value:
        return Path(value["path"])
    if "mapping" in value:
        rows = _unpacked(value["mapping"], buffers, records)
        return dict(rows)
    if "error" in value:
        return _error(value)
    if "record" in value:
        made = records[value["record"]]
        state = _unpacked(value["state"], buffers, records)
        if "__setstate__" not in vars(made):
            return made(**state)
        record: Any = object.__new__(made)
        record.__setstate__(state)
        return record
    return tuple(_unpacked(value["tuple"], buffers, records))


def _array(about: Sequence[Any], single: bool, buffer: np.ndarray) -> Any:
    kind, *shape = about
    dtype = np.dtype(str(kind))
    if dtype.kind not in _KINDS:
        raise TypeError(f"an array of {dtype} is not taken")
    array = buffer.view(dtype).reshape([int(count) for count in shape])
    return array[()] if single else array


def _error(value: Mapping[str, Any]) -> BaseException:
    name = str(value["error"])
    kind = InputError if name == "InputError" else getattr(builtins, name)
    if not issubclass(kind, Exception):
        raise TypeError(f"{name} is no exception")
    error = kind(*value["given"])
    for note in value["notes"]:
        error.add_note(str(note))
    return error
