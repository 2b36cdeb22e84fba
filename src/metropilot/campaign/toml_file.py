"""Parts of campaign files of any kind, validated by pydantic: an error names file and field in a line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from metropilot._io import read_text
from metropilot.errors import InputError
from metropilot.evaluate import is_file
from metropilot.railway import load_trainset

Model = TypeVar("Model", bound=BaseModel)


class StrictModel(BaseModel):
    """Model without unknown keys."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class DrawnTrainsets(StrictModel):
    """Random trainsets: how many, and the seed."""

    drawn: Annotated[int, Field(ge=1, le=10**6)]
    seed: Annotated[int, Field(ge=0, lt=10**9)] = 0


LEAST, MOST = "least", "most"
"""The lightest and the heaviest load of any trainset."""


def read_values(path: Path) -> dict[str, Any]:
    """Values of a TOML file.

    Raises:
        InputError: Not readable, or not TOML.
    """
    try:
        return tomllib.loads(read_text(path, "campaign"))
    except InputError:
        raise
    except (ValueError, RecursionError) as error:
        raise InputError(f"not TOML ({error})", file=path, field="campaign") from None


def validate(path: Path, model: type[Model], values: dict[str, Any]) -> Model:
    """Values of a file as a model.

    Raises:
        InputError: A value cannot be used.
    """
    try:
        return model.model_validate(values)
    except ValidationError as error:
        raise _input_error(path, error) from None


def _input_error(path: Path, error: ValidationError) -> InputError:
    """The first of the validation errors, at the deepest field it names."""
    first = max(error.errors(), key=lambda item: (item["type"] == "extra_forbidden", len(item["loc"])))
    words = [str(part) for part in first["loc"] if not str(part).startswith(("list[", "literal[", "tuple["))]
    known = {"float", "constrained-float", "function-before"}
    field = ".".join(word for word in words if word not in known)
    message = "unknown key" if first["type"] == "extra_forbidden" else first["msg"]
    value = None if first["type"] == "missing" else str(first["input"])
    return InputError(message[:1].lower() + message[1:], file=path, field=field, value=value)


def keep_once(values: list[Any]) -> tuple[Any, ...]:
    """The values without repetitions, in their order."""
    return tuple(dict.fromkeys(values))


def list_trainsets(
    path: Path, wanted: list[str | DrawnTrainsets] | DrawnTrainsets, loads: list[str] | str
) -> tuple[tuple[str, str], ...]:
    """Trainset and load of each; ``least`` and ``most`` are the lightest and the heaviest of a trainset."""
    names: list[str] = []
    for item in wanted if isinstance(wanted, list) else [wanted]:
        numbers = range(1, item.drawn + 1) if isinstance(item, DrawnTrainsets) else ()
        names += [item] if isinstance(item, str) else [f"drawn-{item.seed}-{k}" for k in numbers]
    found = []
    for name in names:
        place = resolve_name(path, name)
        try:
            trainset = load_trainset(place)
            masses = trainset.loads
            ends = {LEAST: min(masses, key=masses.__getitem__), MOST: max(masses, key=masses.__getitem__)}
            named = list(masses) if isinstance(loads, str) else loads
            told = [load if load in masses else ends.get(load, load) for load in named]
            found += [(place, trainset.with_load(load).load) for load in told]
        except InputError as error:
            raise add_place(path, "matrix.trainsets", error) from None
    return keep_once(found)


def resolve_name(path: Path, name: str) -> str:
    """A catalogue id unchanged; a file name relative to the folder of the campaign."""
    return str((path.parent / name).resolve()) if is_file(name) else name


def add_place(path: Path, field: str, error: InputError) -> InputError:
    """The same error with the file and field of the campaign."""
    return error.at(file=path, field=field)
