# SPDX-License-Identifier: Apache-2.0
"""Arguments of public functions and classes, judged by their annotations: what a type checker would
say before a call, a sentence says at it."""

from __future__ import annotations

import builtins
import collections.abc as abc
import inspect
import os
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cache, wraps
from pathlib import PurePath
from types import FunctionType, NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np

from taccel_lab.errors import InputError

Target = TypeVar("Target", bound=Callable[..., Any])
_SHOWN = 60
"""Most letters of a value in a refusal."""
_ARRAYS = ("__array__", "__array_interface__", "__cuda_array_interface__")
"""What arrays of other libraries have one of."""
_WORDS: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "a text",
    NoneType: "None",
    np.ndarray: "an array of numbers",
}


def typed(target: Target) -> Target:
    """A function, or a class by what it is made of, that refuses arguments of another type.

    Numbers of NumPy are numbers, True is none; lists of numbers are arrays. ``Any`` allows
    everything, a class that only type checkers load whatever is not Python's own.

    Calls raise InputError with the name of the argument, what is allowed and what was given.
    """
    function = target.__init__ if isinstance(target, type) else target
    name = target.__name__

    @cache
    def judges() -> dict[str, Any]:
        return dict(_annotations(function))

    parameters = inspect.signature(function).parameters
    places = [*parameters]

    @wraps(function)
    def checked(*arguments: Any, **named: Any) -> Any:
        hints = judges()
        for place, value in (*zip(places, arguments, strict=False), *named.items()):
            hint = hints.get(place, Any)
            if not _fits(value, hint) and value is not parameters[place].default:
                raise InputError(f"{name}: {place} must be {_words(hint)}, got {_shown(value)}")
        return function(*arguments, **named)

    if isinstance(target, type):
        target.__init__ = checked  # type: ignore[misc]
        return target  # type: ignore[return-value]
    return checked  # type: ignore[return-value]


class _Unloaded:
    """A type that only type checkers load: whatever is not of Python's and NumPy's own types."""

    def __class_getitem__(cls, _: Any) -> type[_Unloaded]:
        return cls


class _Names(dict[str, Any]):
    """Names as annotations use them, of modules that are not loaded, too."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, None) or type(name, (_Unloaded,), {})


def _annotations(function: Any) -> Iterator[tuple[str, Any]]:
    """What the parameters of a function may be; those that are not known are left out."""
    function = inspect.unwrap(function)
    loaded = _Names(function.__globals__)
    for name, parameter in inspect.signature(function).parameters.items():
        hint = parameter.annotation
        single = parameter.kind not in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if hint is parameter.empty or not single:
            continue
        try:
            yield name, eval(hint, function.__globals__, loaded) if isinstance(hint, str) else hint
        except AttributeError:  # A name of a module that is not loaded.
            continue


def _fits(value: Any, hint: Any) -> bool:
    """Whether a value is of a type; True for types that nothing can be said of."""
    origin, inner = get_origin(hint), get_args(hint)
    if hint in (Any, inspect.Parameter.empty) or isinstance(hint, TypeVar):
        return True
    if origin in (Union, UnionType):
        return any(_fits(value, one) for one in inner)
    if origin is Literal:
        return isinstance(value, (str, int, NoneType)) and value in inner
    if origin is tuple:
        return _fits_tuple(value, inner)
    if origin in (abc.Mapping, dict):
        return isinstance(value, abc.Mapping)
    if origin is abc.Callable:
        return callable(value)
    if origin in (abc.Sequence, abc.Collection, abc.Iterable, list):
        value = value.tolist() if isinstance(value, np.ndarray) else value
        if not isinstance(value, abc.Iterable) or isinstance(value, (str, bytes, abc.Mapping)):
            return False
        return not isinstance(value, abc.Collection) or all(_fits(v, inner[0]) for v in value)
    return not isinstance(hint, type) or _fits_class(value, hint)


def _fits_class(value: Any, hint: Any) -> bool:
    if issubclass(hint, _Unloaded):
        plain = type(value).__module__ == "builtins" and not isinstance(value, FunctionType)
        return not (plain or isinstance(value, (np.ndarray, os.PathLike)))
    if hint is float:
        return _is_number(value)
    if hint is int:
        return hasattr(type(value), "__index__") and _is_number(value)
    if hint is bool:
        return isinstance(value, (bool, np.bool_))
    if hint is np.ndarray:
        return _is_array(value)
    if issubclass(hint, PurePath):
        return isinstance(value, os.PathLike)
    if issubclass(hint, Enum) and isinstance(value, str):
        return True  # By its value: who takes it says which there are.
    try:
        return isinstance(value, hint)
    except TypeError:  # A protocol says nothing at run time.
        return True


def _fits_tuple(value: Any, inner: tuple[Any, ...]) -> bool:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, (tuple, list)):
        return False
    if inner[1:] == (...,):
        return all(_fits(one, inner[0]) for one in value)
    return len(value) == len(inner) and all(map(_fits, value, inner))


def _is_number(value: Any) -> bool:
    if isinstance(value, (bool, np.bool_)) or not hasattr(type(value), "__float__"):
        return False
    try:
        float(value)
    except (TypeError, ValueError, OverflowError):  # Arrays, and more than a float holds.
        return False
    return True


def _is_array(value: Any) -> bool:
    """Whether numbers can be made of it; arrays of other libraries are taken at their word."""
    if not isinstance(value, (np.ndarray, list, tuple)):
        return any(hasattr(value, name) for name in _ARRAYS)
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except (ValueError, OverflowError):  # Lists of unequal lengths.
        return False


def _words(hint: Any) -> str:
    """What is allowed."""
    kind: Any = hint if isinstance(hint, type) else object
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return " or ".join(dict.fromkeys(map(_words, inner)))
    if origin is Literal:
        return " or ".join(map(repr, inner))
    if origin is tuple and inner[1:] != (...,):
        same = len(set(inner)) == 1
        numbers = f"{len(inner)} numbers" if same and inner[0] in (float, int) else None
        return numbers or f"({', '.join(map(_words, inner))})"
    if origin in (tuple, list, abc.Sequence, abc.Collection, abc.Iterable):
        return f"a list, each of it {_words(inner[0])}"
    if origin in (abc.Mapping, dict):
        return "a dict"
    if origin is abc.Callable:
        return "a function"
    if issubclass(kind, PurePath):
        return "a path"
    if issubclass(kind, Enum):
        return " or ".join(repr(one.value) for one in kind)
    name = getattr(hint, "__name__", f"{hint}")
    return _WORDS.get(hint) or f"{'an' if name[0] in 'AEIOU' else 'a'} {name}"


def _shown(value: Any) -> str:
    """What was given, short."""
    if isinstance(value, (bool, NoneType, float, str, os.PathLike)):
        return repr(value)[:_SHOWN]
    if isinstance(value, int):
        return repr(value) if value.bit_length() < 64 else f"a number of {value.bit_length()} bits"
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {list(value.shape)}"
    if isinstance(value, (list, tuple)) and len(value) <= 4:
        shown = f"[{', '.join(map(_shown, value))}]"
        return shown if len(shown) <= _SHOWN else f"a {type(value).__name__} of {len(value)}"
    return f"a value of type {type(value).__name__}"
