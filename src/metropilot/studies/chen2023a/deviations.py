"""Where the study departs from the paper, and what it assumes where the paper is silent."""

from __future__ import annotations

from metropilot.env.registry import CHEN2023A_STOP_MPS2 as STOP_MPS2
from metropilot.studies.chen2023a.learners import (
    DECISIONS,
    FIRST_COMMAND,
    LEARNERS,
    NAMES,
    TRIALS,
    TUNING_EPISODES,
    TUNING_SEEDS,
    trials,
)
from metropilot.studies.chen2023a.setting import UNASSISTED_TOLERANCE_M

SEEDS = " and ".join(str(seed) for seed in TUNING_SEEDS)
DONE = ", ".join(f"{NAMES[name]} {len(trials(name))}" for name in LEARNERS)
TEXT = f"""
Section, trainset and speed limits are not printed. We take Yizhuang Bridge to Yizhuang Culture Park of the
Beijing Yizhuang line (993 m) and the 300 t trainset of the same group (Cheng et al. 2023), with ideal
actuation; 80 s prescribed and 88 s allowed as in the paper.

The paper never says who brakes to the stop point, nor how exactly it stands. Here the stop assist makes the
last braking at {STOP_MPS2:g} m/s² for all three learners, and the speed limit is kept (its eq. 12), so
stopping errors are the assist's. The table without it shows the learners alone: they arrive when they stand
within {UNASSISTED_TOLERANCE_M:g} m of the stop.

Coefficients of eqs. 16 and 17 are not printed: a kWh at the wheel costs 1, a change of acceleration of 1
m/s² costs 0.1, arriving within 8 s of 80 s earns 100, anything else loses 100.

A run that never arrives loses 100 more and 0.1 a metre left. The paper's train always
arrives; without this price standing still would be the best way to be late, and PPO finds it.

One decision a second; plant, assists and protection at 0.5 s. Protection supervises every step. Energy
counts at the wheel, without efficiency (its eq. 3 less a constant factor).

All policies begin at a mean command of {FIRST_COMMAND:g}, so that some first episodes arrive in time.

None of its learning settings is printed. Ours come from random trials of {TUNING_EPISODES:,} episodes, the
defaults first, on seeds {SEEDS}, which no table reports (`python -m benchmarks.chen2023a_tuning`, {TRIALS}
for each learner when complete). Trials these settings rest on: {DONE}. PPO with and without scaling tried the
same settings.

Converged means: from then on, in 95 % of the chunks (about 120 episodes each), the mean running time of the
episodes is at most 88 s and their mean return within 10 % of the final one. Final values are medians over
the last tenth of the learning.

Episodes are counted as they end; a run is given the steps of the stated number of episodes of {DECISIONS}
decisions, so learners with short or long episodes end with a few more or fewer.
"""


def deviations() -> list[str]:
    """One paragraph each."""
    return [" ".join(part.split()) for part in TEXT.strip().split("\n\n")]
