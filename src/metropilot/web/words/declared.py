"""Texts that the library declares and the pages show."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import BaseModel

from metropilot._schema import field_specs
from metropilot.drivers import DRIVERS
from metropilot.evaluate import run_fields
from metropilot.learn import RECIPES
from metropilot.sim import Disturbance
from metropilot.studies import STUDIES
from metropilot.web.schemas import requests


def declared_texts() -> Iterator[str]:
    """Yield labels of fields, and one-sentence descriptions of drivers, recipes and studies."""
    for kind in vars(requests).values():
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from filter(None, (requests.spec_of(kind, name).label for name in kind.model_fields))
    yield from filter(None, (spec.label for spec in field_specs(Disturbance).values()))
    yield run_fields()["ideal"].help.rstrip(".")
    for registry in (DRIVERS, RECIPES, STUDIES):
        yield from (row.summary for row in registry.rows().values())
