"""Cheng et al. 2023: tracking a reference with a PID whose gains are learned."""

from metropilot.studies.cheng2023.courses import REFERENCES
from metropilot.studies.cheng2023.published import CITATION
from metropilot.studies.cheng2023.reproduce import reproduce
from metropilot.studies.study import Study

__all__ = ["STUDY"]

STUDY = Study(
    id="cheng2023",
    title="Tracking a reference: DDPG-PID against PID, fuzzy and neural PID (Cheng et al. 2023)",
    citation=CITATION,
    reproduce=reproduce,
    options={"reference": tuple(REFERENCES)},
)
