"""Lu and Liu 2023: driving by twelve notches, learned by improved DQN."""

from metropilot.studies.lu2023.published import CITATION
from metropilot.studies.lu2023.reproduce import reproduce
from metropilot.studies.study import Study

__all__ = ["STUDY"]

STUDY = Study(
    id="lu2023",
    title="Notch driving by improved DQN (Lu and Liu 2023)",
    citation=CITATION,
    reproduce=reproduce,
)
