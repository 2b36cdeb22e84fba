"""Texts that the library declares and the pages show."""

from __future__ import annotations

from collections.abc import Iterator

from pydantic import BaseModel

from metropilot._schema import field_specs
from metropilot.drivers import DRIVERS
from metropilot.evaluate import run_fields
from metropilot.learn import RECIPES
from metropilot.sim import Disturbance
from metropilot.studies import STUDIES, published_study
from metropilot.web.schemas import requests
from metropilot.web.words.said import JOINTS, sentence_patterns


def declared_texts() -> Iterator[str]:
    """Yield labels of fields, descriptions of drivers, recipes and studies, and what studies claim."""
    for kind in vars(requests).values():
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from filter(None, (requests.spec_of(kind, name).label for name in kind.model_fields))
    yield from filter(None, (spec.label for spec in field_specs(Disturbance).values()))
    yield run_fields()["ideal"].help.rstrip(".")
    for registry in (DRIVERS, RECIPES, STUDIES):
        yield from (row.summary for row in registry.rows().values())
    for found in map(published_study, STUDIES.ids()):
        claims = [row["claim"] for row in found.verdicts]
        whole = [text for text in claims if not any(joint in text for joint in JOINTS)]
        for text in (found.title, *whole, *(figure.caption for figure in found.figures)):
            if not any(pattern.fullmatch(text) for _, pattern in sentence_patterns()):
                yield text
