"""Checks of metropilot's functions while the tests run: shapes where there are any, types always.

jaxtyping's wrapper binds a call's arguments anew to give its axes names; of a drive's millions of small calls
between floats that is two thirds of the time, for nothing: without axes there is nothing to name. Those get
the same type checker directly. The types checked are the same ones either way.
"""

import dataclasses
import functools
import inspect
import types
import typing
from collections.abc import Callable
from typing import Any

import jaxtyping
from beartype import BeartypeConf, beartype

_with_axes = jaxtyping.jaxtyped
_types_only = beartype(conf=BeartypeConf(violation_type=jaxtyping.TypeCheckError))


def install(package: str) -> None:
    """Check every annotated function of `package` from now on; call before its first import."""
    jaxtyping.jaxtyped = _decorate
    jaxtyping.install_import_hook(package, "beartype.beartype")


def _decorate(fn: Any = None, *, typechecker: Any = None) -> Any:
    """Decorator of the import hook for every function and class, instead of jaxtyping's own."""
    if fn is None:
        return functools.partial(_decorate, typechecker=typechecker)
    if inspect.isclass(fn) and dataclasses.is_dataclass(fn) and _is_plain(fn.__init__):
        hints = _hints(fn.__init__)
        if not any(map(_has_axes, hints.values())):
            fn.__init__ = _add_checks(fn.__init__, hints)
            return fn
    elif _is_plain(fn):
        hints = _hints(fn)
        if not any(map(_has_axes, hints.values())):
            return _add_checks(fn, hints)
    return _with_axes(fn, typechecker=typechecker)


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


def _add_checks(fn: types.FunctionType, hints: dict[str, Any]) -> Callable[..., Any]:
    resolved = types.FunctionType(fn.__code__, fn.__globals__, fn.__name__, fn.__defaults__, fn.__closure__)
    resolved.__kwdefaults__ = fn.__kwdefaults__
    resolved.__module__, resolved.__qualname__ = fn.__module__, fn.__qualname__
    resolved.__annotations__ = hints
    return functools.wraps(fn)(_types_only(resolved))
