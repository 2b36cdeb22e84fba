"""Huang et al. 2025: an expert system, and PPO inside it, against manual driving, ITOR and STON."""

from metropilot.studies.huang2025.published import CITATION, TITLE
from metropilot.studies.huang2025.reproduce import reproduce
from metropilot.studies.study import Study

__all__ = ["STUDY"]

STUDY = Study(id="huang2025", title=TITLE, citation=CITATION, reproduce=reproduce)
