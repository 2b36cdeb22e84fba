"""Checks of metropilot's functions while the tests run: shapes where there are any, types always.

jaxtyping's wrapper binds a call's arguments anew to give its axes names; of a drive's millions of small calls
between floats that is two thirds of the time, for nothing: without axes there is nothing to name. Those get
the same type checker directly. The types checked are the same ones either way.

A drive calls the same functions ten thousand times from the same places, and defines functions inside of
others as often. In every test the first ``FIRST`` calls of a function are checked, and later ones every
``EVERY``-th time; of a function inside of another the first ``DEFINED`` definitions. All of them would be
half of the time of a drive.
"""

import collections
import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

FIRST, EVERY, DEFINED = 100, 32, 8

_with_axes = jaxtyping.jaxtyped
_types_only = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))


def install(package: str) -> None:
    """Check every annotated function of `package` from now on; call before its first import."""
    jaxtyping.jaxtyped = _decorate
    jaxtyping.install_import_hook(package, "beartype.beartype")


_left: list[list[int]] = []
"""Of each function: calls that are checked without a pause, in this test."""
_defined: collections.Counter[types.CodeType] = collections.Counter()
"""Of each function inside of another: its definitions in this test."""


def begin_test() -> None:
    """Count calls and definitions from the beginning."""
    for left in _left:
        left[0] = FIRST
    _defined.clear()


def _decorate(fn: Any = None, *, typechecker: Any = None) -> Any:
    """Decorator of the import hook for every function and class, instead of jaxtyping's own."""
    if fn is None:
        return functools.partial(_decorate, typechecker=typechecker)
    if inspect.isclass(fn) and dataclasses.is_dataclass(fn) and _is_plain(fn.__init__):
        if not any(map(_has_axes, _hints(fn.__init__).values())):
            fn.__init__ = _check_sometimes(fn.__init__, typechecker)
            return fn
    elif _is_plain(fn):
        if "<locals>" in fn.__qualname__:
            _defined[fn.__code__] += 1
            if _defined[fn.__code__] > DEFINED:
                return fn
        return _check_sometimes(fn, typechecker)
    return _with_axes(fn, typechecker=typechecker)


def _check_sometimes(fn: Any, typechecker: Any) -> Callable[..., Any]:
    """The function with its checks in the first calls of a test and in some of the later ones."""
    checked, left = None, [FIRST]
    if "<locals>" not in fn.__qualname__:
        _left.append(left)

    @functools.wraps(fn)
    def call(*args: Any, **kwargs: Any) -> Any:
        nonlocal checked
        left[0] -= 1
        if left[0] < 0:
            if left[0] > -EVERY:
                return fn(*args, **kwargs)
            left[0] = 0
        if checked is None:
            checked = _add_checks(fn, typechecker)
        return checked(*args, **kwargs)

    return call


def _is_plain(fn: Any) -> bool:
    """True for a function that returns what its annotation says: no generator, no coroutine."""
    return (
        inspect.isfunction(fn)
        and not inspect.isgeneratorfunction(fn)
        and not inspect.iscoroutinefunction(fn)
        and not inspect.isasyncgenfunction(fn)
    )


def _hints(fn: types.FunctionType) -> dict[str, Any]:
    """A function's annotations as types; one whose names are not there yet is left out, as jaxtyping does."""
    hints = {}
    for name, annotation in fn.__annotations__.items():
        one = types.SimpleNamespace(__annotations__={name: annotation})
        try:
            hints |= typing.get_type_hints(one, fn.__globals__, include_extras=True)
        except (NameError, AttributeError, TypeError, ValueError):
            continue
    return hints


def _has_axes(hint: Any) -> bool:
    """True if a type is, or is made of, one of jaxtyping's."""
    if isinstance(hint, (list, tuple)):
        return any(map(_has_axes, hint))
    if isinstance(hint, (str, typing.ForwardRef, typing.TypeVar)):
        return True
    return type(hint).__module__.startswith("jaxtyping") or any(map(_has_axes, typing.get_args(hint)))


def _add_checks(fn: types.FunctionType, typechecker: Any) -> Callable[..., Any]:
    """The function with its checks, made when it is first called: most are not, in a short program."""
    hints = _hints(fn)
    if any(map(_has_axes, hints.values())):
        return _with_axes(fn, typechecker=typechecker)
    resolved = types.FunctionType(fn.__code__, fn.__globals__, fn.__name__, fn.__defaults__, fn.__closure__)
    resolved.__kwdefaults__ = fn.__kwdefaults__
    resolved.__module__, resolved.__qualname__ = fn.__module__, fn.__qualname__
    resolved.__annotations__ = hints
    return functools.wraps(fn)(_types_only(resolved))
