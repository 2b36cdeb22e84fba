"""Deviations from the paper, and findings in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Sequence

from metropilot.studies.lu2023.drives import SPAN_M, policy_file
from metropilot.studies.lu2023.learning import RULE
from metropilot.studies.lu2023.setting import (
    ABLATION,
    BEYOND,
    CONVERGENCE,
    FASTER_PERCENT,
    PLANS,
    RULES,
    TABLE,
)
from metropilot.studies.report import ReportRow, paragraphs
from metropilot.studies.verdict import Claim

STOP, LATE, ENERGY = "stopping error", "time error", "wheel traction energy"
PID = "pid_lu2023"
FASTER, CHANCE = "converges faster than DQN", "p of that it converges as fast as DQN (log-rank)"
GAP = "wheel traction above the optimum over the notches"
LIMIT_MPS2 = 0.8
"""Largest acceleration in the paper."""


def _claim(plan: str, kpi: str, words: str) -> Claim:
    return Claim(f"{words}, {plan}", "improved_dqn", kpi, plan, rivals=(PID, RULES), table=TABLE)


CLAIMS = (
    *(
        _claim(plan.name, kpi, words)
        for plan in PLANS
        for kpi, words in (
            (STOP, "improved DQN stops at the mark"),
            (LATE, "it keeps the time"),
            (ENERGY, "it saves energy"),
        )
    ),
    Claim(
        "improved DQN converges faster than DQN, 120 s",
        "improved_dqn",
        FASTER,
        "120 s",
        "high",
    ),
)

DEVIATIONS = paragraphs("""
The stop is not learned. Station-stop braking follows the stop curve of the task's assist, with the
weakest sufficient notch of the paper, five times a second; the network decides everything before it and
may brake earlier. The paper does not explain how its network stops within 0.3 m.

Traction that would exceed protection's permitted speed is reduced notch by notch (the ceiling assist),
and protection supervises; the paper ends the episode instead.

A decision is held for 3 s of 0.2 s control periods; the paper transfers its state after 0.2 s and 0.1 m
(both are always exceeded here except at standstill), and discounts by 0.98 per transfer, so that the
arrival has no weight at departure. Here gamma is 1.

The state is position, speed and the time left, and quantities that follow from them and the line: the
filter's quantity (time left beyond the flat-out time to go, in three scalings) and the permitted speed
ahead. With (x, v, t) alone the same learner needed several times the updates.

Learning rate 1e-3 falling to 3e-5 with Adam instead of 1e-5; rewards divided by 200; observations
normalised by their running mean and deviation; a memory of 40,000; 0.5 gradient steps per decision over
eight parallel environments. Of these the paper gives only the learning rate. DQN and improved DQN use the
same values.

A network learns for 60,000 decisions, about 2,000 episodes; the networks of the plan with the restriction
and of all plans for 160,000. Every one of six seeds (ten where convergence is compared, three for all plans)
is driven; the driver that is shipped is the median seed.

Epsilon falls from 0.5 (paper: 0.8) to 0.05 over the first 30 % of the run.

Most episodes start during the run, with a time left between the flat-out time and 1.7 times it, so that a
network meets every state; the paper starts each at the origin. Evaluations start from standstill.

Eq. 15 is learned with 2.5 s instead of 3 s, for a margin of half a second on the host.

Eq. 18 prints P + a for gentle accelerations, which rewards acceleration: P - |a| here, P = 1, L = -10 and
a_lim = 0.8 m/s2 assumed; r_v = 0.01 assumed.

The flat-out time of the filter is that of the plant with resistance and limits, 6 % longer to keep clear
of protection; the paper's changes speed at once and has no resistance.

Prioritised replay draws by proportional priority with exponent 0.6 (paper: 1) and corrects by importance
weights (paper eq. 13: a learning rate per sample).

The trainset has the strongest notches, 180 and 149 kN, as its limits; the paper also names 203 and 166
kN.

The PID's gains are Cheng23's (3.4, 0.3, 0.2), since the paper gives none; the last metres use the
station-stop law.
""")


def remarks(rows: Sequence[ReportRow], *, budget: str) -> list[str]:
    """Findings as sentences made from the rows: medians over the seeds, the worst plan."""
    plans = [row for row in rows if row.table == TABLE and row.driver == "improved_dqn"]
    pid = [row for row in rows if row.table == TABLE and row.driver == PID]
    switches = f"most switches of regime in {SPAN_M:.0f} m"

    def worst(kpi: str, among: Sequence[ReportRow]) -> float:
        return max(
            (row.ours for row in among if row.kpi == kpi and row.ours is not None), default=float("nan")
        )

    stop, late, over, above = (worst(kpi, plans) for kpi in (STOP, LATE, "largest overspeed", GAP))
    hard, jerk = worst("largest acceleration", plans), worst("largest jerk", plans)
    kept = "within" if hard <= LIMIT_MPS2 + 0.005 else "beyond"
    said = [
        (
            f"The plans of Table 5 stop within {stop:.2f} m and {late:.1f} s, at most {over:.2f} m/s "
            f"over the limit, and need at most {above:.1f} % more wheel traction energy than the optimum "
            "over the notches."
        ),
        (
            f"Their largest acceleration is {hard:.2f} m/s², {kept} the paper's {LIMIT_MPS2:g}, their "
            f"largest jerk {jerk:.1f} m/s³, and they change between traction, coasting and braking at most "
            f"{worst(switches, plans):.0f} times in {SPAN_M:.0f} m (the paper's PID 13, here {PID} "
            f"{worst(switches, pid):.0f})."
        ),
    ]
    said.append(
        "That optimum (dynamic programming, `metropilot.studies.lu2023.notch_plan`) is within 1 % of the "
        "convex one over all forces: full traction, coasting and braking are notches."
    )
    said.append(
        "It is unclear whether the published kWh include braking work (eq. 16 does); both are listed."
    )
    beyond = [row for row in rows if row.table == BEYOND]
    if beyond:
        said.append(
            "One network that observes the time left and the limits ahead drives all four plans "
            f"within {worst(STOP, beyond):.2f} m and {worst(LATE, beyond):.1f} s, "
            f"at most {worst(GAP, beyond):.1f} % above the optimum."
        )
    if budget == "paper":
        said.append(RULE)
        said.extend(_compare_convergence(rows))
    else:
        said.append("Quick: the plans are driven by shipped policies; convergence needs `--budget paper`.")
    alone = [plan.id for plan in PLANS if not policy_file(f"improved_dqn-{plan.id}").is_file()]
    if budget != "paper" and alone:
        said.append(
            f"No network of a single plan is shipped for {', '.join(alone)}: the network for all "
            "plans is driven."
        )
    return said


def _compare_convergence(rows: Sequence[ReportRow]) -> list[str]:
    """Comparison of improved DQN with DQN, and of each improvement left out, by survival statistics."""
    found = []
    for row in (row for row in rows if row.table == CONVERGENCE and row.kpi == FASTER):
        p = next((one.ours for one in rows if (one.case, one.kpi) == (row.case, CHANCE)), None)
        gain = "cannot be compared (a median is not reached)" if row.ours is None else f"{row.ours:+.0f} %"
        sure = "too few converged for a test" if p is None else f"log-rank p = {p:.2g}"
        found.append(
            f"{row.case}: speed-up of improved DQN over DQN {gain}, {sure}; published {FASTER_PERCENT} % "
            "at 120 s."
        )
    shares = {row.driver: row.ours for row in rows if row.table == ABLATION and row.unit == "%"}
    if shares:
        parts = ", ".join(f"`{name}` {share:.0f} %" for name, share in shares.items() if share is not None)
        found.append(f"Ablation, runs that were steady: {parts}.")
    return found
