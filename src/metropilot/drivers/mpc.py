"""Model-predictive driving: the rest of the run planned anew every few seconds.

Following, estimation, stopping and manners towards protection are those of the driver ``optimal``; what
differs is when it plans and what it believes. A plan of the data sheet that is followed well is not departed
from, and yet is the wrong plan where mass or resistance are not nominal: so the rest of the run is planned
again at a fixed period, from the measured state, over the time that is left, with traction gain, brake gain
and resistance factor as the observer has them by then. That the brake is controlled to a rate at any load,
which the data sheet says, is believed: a wrong mass need not make anybody brake early.

A plan made on the way starts from the one before, which saves a third of its passes; in between the plan is
followed. Each begins with a small correction, which a lag drags on until the next plan corrects it back:
where commands act late, a plan that still holds is not made again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, final, get_args

from metropilot._schema import CheckedFields, declare
from metropilot.drivers.optimal import Optimal, OptimalOptions
from metropilot.planning import Objective


@dataclass(frozen=True)
class MpcOptions(CheckedFields):
    """Options of ``mpc``: period and objective of the plan.

    Attributes:
        objective: Energy the plan saves: ``wheel`` or ``line``.
        period_s: Time between two plans; news and departures from the plan call for one at once, and where
            commands act late a plan that still holds is kept.
        brake_use: Share of the braking force planned with where commands act late or the mass is not nominal.
        reserve_s: Time before the scheduled one at which the plan arrives.
        spacing_m: Mesh of the plan.
    """

    objective: Objective = declare("wheel", choices=get_args(Objective))
    period_s: float = declare(3.0, unit="s", low=0.0, above=True)
    brake_use: float = declare(0.97, low=0.0, high=1.0, above=True)
    reserve_s: float = declare(0.0, unit="s", low=0.0)
    spacing_m: float = declare(12.5, unit="m", low=1.0, high=200.0)


@final
class Mpc(Optimal):
    """Plans the rest of the run anew every few seconds."""

    id: ClassVar[str] = "mpc"

    def __init__(self, options: MpcOptions | None = None) -> None:
        chosen = options or MpcOptions()
        super().__init__(
            OptimalOptions(
                objective=chosen.objective,
                period_s=chosen.period_s,
                careful_brake_use=chosen.brake_use,
                reserve_s=chosen.reserve_s,
                spacing_m=chosen.spacing_m,
            )
        )
