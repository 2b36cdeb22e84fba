"""Where the study departs from the paper, and what its numbers say."""

from __future__ import annotations

from collections.abc import Sequence

from metropilot.studies.chen2023b.setting import PUBLISHED
from metropilot.studies.report import Row

DEVIATIONS = (
    (
        "Sign of the speed difference: with eq. 10 (own speed less the speed ahead) the law of eq. 12 is "
        "unstable; the speed ahead less the own one is used."
    ),
    (
        "The text's largest gap error of 0.6 m contradicts its gap of 5.88 to 5.98 m; it is taken to be "
        "0.06 m."
    ),
    "Eq. 18 rewards a gap of 0, a contact; the reward counts the gap less the wanted 5.92 m.",
    "Eq. 17 bounds the command to [0, 1], so that nothing could brake; it is [-1, 1].",
    (
        "With eta = 1000 the reward is next to nothing beyond a few millimetres; eta is 100 1/(m/s) and "
        "200 1/m unless `--set eta=paper` asks for 1000."
    ),
    (
        "Train, time step, head's profile, network and learning rates are not printed: trainset "
        "`cheng2023`, 0.1 s, an S-curve of 0.65 m/s² and 0.5 m/s³ in 100 s on YZQ–WHY, two layers of 64, "
        "batch 128, gamma 0.95. The profile leaves the follower some traction; what a PID on the speed "
        "difference leaves of the gap grows with the head's acceleration and with the time step."
    ),
    (
        "96,000 steps behind 24 different heads, a fifth of the episodes with other masses and links, "
        "instead of 10,000 episodes behind one head; learned without protection, driven under it."
    ),
)


def remarks(rows: Sequence[Row]) -> list[str]:
    """What the numbers say, in words that follow them."""
    value = {(row.driver, row.kpi): float(row.ours or 0.0) for row in rows if row.table == "Figs. 7 to 9"}
    low, high = value["sac_pid", "smallest gap"], value["sac_pid", "largest gap"]
    apart = value["sac_pid", "largest speed difference"]
    within = (
        low >= PUBLISHED["gap_min_m"]
        and high <= PUBLISHED["gap_max_m"]
        and apart <= PUBLISHED["speed_difference_max_mps"]
    )
    verdict = "within what is published" if within else "the published band is missed"
    pid = [value["follow_pid", f"{which} gap"] for which in ("smallest", "largest")]
    linear = [value["follow_gap", f"{which} gap"] for which in ("smallest", "largest")]
    ddpg = [value["ddpg_pid_follow", f"{which} gap"] for which in ("smallest", "largest")]
    return [
        (
            f"SAC-PID holds the gap within {low:.3f} to {high:.3f} m and the speed difference within "
            f"{apart:.3f} m/s: {verdict}."
        ),
        (
            f"What is learned is little: the same PID with fixed gains at the upper end of the paper's "
            f"bounds stays within {pid[0]:.3f} to {pid[1]:.3f} m. A PID on the speed difference does not "
            "see the gap: while the head's acceleration changes by a, the gap gives way by about a times "
            "the time step over the integral gain, whatever the gains' schedule."
        ),
        (
            f"`follow_gap`, a linear controller that looks at the gap and at the acceleration ahead, stays "
            f"within {linear[0]:.3f} to {linear[1]:.3f} m and learns nothing."
        ),
        (
            f"DDPG does not fail here as it does in the paper: {ddpg[0]:.3f} to {ddpg[1]:.3f} m. Its reward "
            "does not fall."
        ),
        (
            "No contact is a property of protection, not of the followers: in the campaign most followers "
            "mean harm, and without protection most cases end in a contact."
        ),
    ]
