"""Published results of Cheng et al. 2023: tables 1, 3 and 4."""

from __future__ import annotations

CITATION = (
    "G. Cheng, D. Wang, M. Sun, Z. Fu, B. Yuan, L. Zhang, X. Xiao: Optimizing Subway Train Operation With "
    "Hierarchical Adaptive Control Approach. IEEE Access 11, 2023, doi 10.1109/ACCESS.2023.3341212."
)

KPIS = (
    ("speed_total_mps", "total speed error", "m/s"),
    ("speed_max_mps", "largest speed error", "m/s"),
    ("position_total_m", "total position error", "m"),
    ("position_max_m", "largest position error", "m"),
    ("parking_m", "parking error", "m"),
    ("energy_kwh", "energy at wheel", "kWh"),
    ("jerk_mps3", "jerk over 2 s", "m/s3"),
)
"""Columns of tables 1 and 3: field of ``TrackingKpis``, words, unit. Totals sum over periods of 0.2 s."""

TABLE_1 = {
    "pid": (24.29, 0.31, 48.96, 0.97, 0.17, 17.55, 0.93),
    "fuzzy_pid": (6.95, 0.28, 17.49, 0.56, 0.02, 17.40, 0.49),
    "neural_pid": (6.32, 0.27, 16.78, 0.47, 0.00, 17.16, 0.65),
    "ddpg_pid": (3.51, 0.17, 10.32, 0.34, 0.00, 17.04, 0.39),
}
TABLE_3 = {
    1: TABLE_1["ddpg_pid"],
    2: (9.48, 0.32, 25.80, 0.94, 0.00, 19.07, 0.40),
    3: (6.57, 0.25, 13.41, 0.65, 0.01, 14.98, 0.39),
}
TABLE_4 = {
    1: (0.01, 0.17, 0.02, 0.34, 0.00, 17.04, 0.39),
    4: (0.05, 0.60, 0.34, 2.92, 0.07, 19.36, 0.50),
    5: (0.01, 0.05, 0.00, 0.01, 0.02, 15.22, 0.44),
}
"""Results of DDPG-PID; the first and third columns are averages over the run."""
