"""Published results of Chen et al. 2023 (Actuators)."""

from __future__ import annotations

CITATION = (
    "Chen, B.; Zhang, L.; Cheng, G.; Liu, Y.; Chen, J. *A Novel Approach for Train Tracking in Virtual "
    "Coupling Based on Soft Actor-Critic*. Actuators 2023, 12(12), 447, doi 10.3390/act12120447."
)
PUBLISHED = {"gap_min_m": 5.88, "gap_max_m": 5.98, "speed_difference_max_mps": 0.15}
"""Chen23b section 4: figs. 8 and 9."""
