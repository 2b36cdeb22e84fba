"""A line fed by a DC network: energy by headway, worth of each assumed number, and the time of a working day.

python -m benchmarks.feeding --write docs/line.md
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy import ndarray

from benchmarks.beside_optimum import table
from benchmarks.report import circumstances, write_section
from metropilot._io import load_or_compute
from metropilot.errors import Infeasible
from metropilot.operation import (
    FeedingEnergy,
    LineOperation,
    OperationOptions,
    Timetable,
    TrainLoads,
    feed_line,
    solve_network,
    train_loads,
)
from metropilot.railway import Feeding, Storage, load_feeding, load_line, load_trainset
from metropilot.units import J_PER_KWH

LINE, TRAINSET, LOAD, FEEDING = "yizhuang", "dkz32", "AW2", "yizhuang"
HEADWAYS_S, SENSITIVE_S, OFFSET_S = (90, 120, 180, 300, 600), 180, 5
OPTIONS = OperationOptions(efficiency_traction=0.9, efficiency_braking=0.76)
DAY_H, PEAKS_H, PEAK_S, QUIET_S = 18, 4, 240, 496
DAYS = (0.25, 1.0, 4.0)
STORAGE_OFFSET_S = 15


class Fed:
    """A line at a headway with both ways of driving, and what a network makes of every offset.

    Args:
        headway_s: Headway.
        plans: Powers of the trips by driving, at planned running times.
        every_s: Step of the offsets.
    """

    def __init__(self, headway_s: int, plans: dict[str, list], every_s: int = OFFSET_S) -> None:
        line, trainset = load_line(LINE), load_trainset(TRAINSET, LOAD)
        self.operation = LineOperation(line, trainset, replace(OPTIONS, headway_s=headway_s))
        self.plans, self.headway_s = plans, headway_s
        self.offsets = np.arange(0.0, headway_s, every_s)

    def timetable(self, offset_s: float) -> Timetable:
        """Planned running times and dwells at an offset."""
        return self.operation.plain_timetable(offset_s)

    def energies_kwh(self, driving: str, feeding: Feeding) -> ndarray:
        """Energy of every offset, all of them one long run of seconds if there is no storage."""
        if feeding.storages or feeding.onboard is not None:
            plans = self.plans[driving]
            tables = [self.timetable(offset_s) for offset_s in self.offsets]
            return np.array([feed_line(self.operation, each, plans, feeding).energy_kwh for each in tables])
        parts = []
        for k, offset_s in enumerate(self.offsets):
            loads, seconds = train_loads(self.operation, self.timetable(offset_s), self.plans[driving])
            parts.append(loads._replace(second=loads.second + k * seconds))
        loads = TrainLoads(*(np.concatenate(each) for each in zip(*parts, strict=True)))
        flow = solve_network(feeding, loads, self.offsets.size * self.headway_s)
        flow.check_served()
        net_w = (flow.rectifier_w - flow.inverter_w).sum(axis=1)
        return net_w.reshape(self.offsets.size, -1).sum(axis=1) / J_PER_KWH

    def row(self, feeding: Feeding) -> dict[str, float]:
        """Energies by driving and offset, and the flow of optimal driving at its best offset."""
        cruise, optimal = (self.energies_kwh(each, feeding) for each in ("cruise", "optimal"))
        best = self.timetable(self.offsets[int(np.argmin(optimal))])
        told = feed_line(self.operation, best, self.plans["optimal"], feeding).as_dict()
        return {
            "cruise": cruise.mean(),
            "driving": optimal.mean(),
            "timetable": cruise.min(),
            "both": optimal.min(),
            **{name: told[name] for name in ("rail_loss_kwh", "substation_loss_kwh", "squeezed_kwh")},
            **{name: told[name] for name in ("lowest_v", "peak_w")},
            "substation_w": max(each["peak_w"] for each in told["substations"]),
        }


def planned_profiles() -> dict[str, list]:
    """Powers of all trips at their planned running times."""
    operation = LineOperation(load_line(LINE), load_trainset(TRAINSET, LOAD), OPTIONS)
    return {driving: list(operation.profiles(driving)) for driving in ("optimal", "cruise")}


def floor_kwh() -> float:
    """Least energy at planned running times where no returned joule is lost."""
    options = replace(OPTIONS, transfer_loss=0.0)
    operation = LineOperation(load_line(LINE), load_trainset(TRAINSET, LOAD), options)
    return operation.floor_j(operation.profiles()) / J_PER_KWH


def variants(feeding: Feeding) -> Iterator[tuple[str, Feeding]]:
    """The feeding with one assumed number changed."""

    def each(**change: float) -> Feeding:
        return replace(feeding, substations=tuple(replace(s, **change) for s in feeding.substations))

    yield "as assumed", feeding
    for volts in (825.0, 859.0):
        yield f"no load {volts:g} V", each(no_load_v=volts)
    for ohm in (0.005, 0.02):
        yield f"inner resistance {1000.0 * ohm:g} mohm", each(resistance_ohm=ohm)
    for ohm in (4e-6, 16e-6):
        yield f"conductor rail {1e6 * ohm:g} mohm/km", replace(feeding, conductor_ohm_per_m=ohm)
    for ohm in (9e-6, 36e-6):
        yield f"running rails {1e6 * ohm:g} mohm/km", replace(feeding, running_ohm_per_m=ohm)
    for volts in (880.0, 1000.0):
        yield f"nothing returned at {volts:g} V", replace(feeding, max_v=volts)
    yield "squeezed above 890 V", replace(feeding, squeezed_above_v=890.0)
    yield "every second substation", replace(feeding, substations=feeding.substations[::2])
    yield "inverters everywhere, 855 V, 10 mohm", each(inverter_v=855.0, inverter_ohm=0.01)


def stores(feeding: Feeding) -> Iterator[tuple[str, Feeding]]:
    """The feeding without and with storages, of assumed sizes and voltages."""
    yield "none", feeding
    usual = {"charge_above_v": 860.0, "discharge_below_v": 820.0, "resistance_ohm": 0.01, "efficiency": 0.95}
    beside = [
        Storage(name=s.name, position_m=s.position_m, capacity_j=10.0 * J_PER_KWH, power_w=1.5e6, **usual)
        for s in feeding.substations
    ]
    yield "storage at all substations, 10 kWh, 1.5 MW", replace(feeding, storages=tuple(beside))
    yield "the same at every second one", replace(feeding, storages=tuple(beside[::2]))
    aboard = Storage(name="on board", capacity_j=3.0 * J_PER_KWH, power_w=8e5, **usual)
    yield "storage on board, 3 kWh, 0.8 MW", replace(feeding, onboard=aboard)
    lower = replace(aboard, charge_above_v=845.0)
    yield "the same charged above 845 V", replace(feeding, onboard=lower)


def day_starts(days: float) -> tuple[list[int], list[int]]:
    """First departures of both directions: four peak hours among quiet ones, 162 each way in a day."""
    hours = [PEAK_S if hour in {2, 3, 11, 12} else QUIET_S for hour in range(DAY_H)]
    starts, clock = [], 0.0
    while clock < days * DAY_H * 3600:
        starts.append(round(clock))
        clock += hours[int(clock // 3600) % DAY_H]
    return starts, [start + 60 for start in starts]


def time_day(plans: dict[str, list], feeding: Feeding, days: float) -> list[str]:
    """Cells of the table of times."""
    fed, starts = Fed(SENSITIVE_S, plans), day_starts(days)
    wall, processor = time.perf_counter(), time.process_time()
    loads, seconds = train_loads(fed.operation, fed.timetable(0.0), plans["optimal"], starts)
    flow = solve_network(feeding, loads, seconds)
    lasted, used = time.perf_counter() - wall, time.process_time() - processor
    trips = len(starts[0]) + len(starts[1])
    return [
        f"{trips}",
        f"{seconds}",
        f"{loads.second.size}",
        f"{used:.1f}",
        f"{lasted:.1f}",
        f"{flow.steps}",
        f"{abs(flow.imbalance):.0e}",
        f"{flow.train_v.min():.0f}",
    ]


def cells(found: dict[str, float]) -> list[str]:
    """Losses, squeezed energy, voltage and peaks of a row."""
    names = ("rail_loss_kwh", "substation_loss_kwh", "squeezed_kwh")
    return [
        *(f"{found[name]:.1f}" for name in names),
        f"{found['lowest_v']:.0f}",
        f"{found['peak_w'] / 1e6:.1f}",
        f"{found['substation_w'] / 1e6:.1f}",
    ]


def measure() -> str:
    """Text of the page's part."""
    plans, feeding, floor = planned_profiles(), load_feeding(FEEDING), floor_kwh()
    days = [time_day(plans, feeding, each) for each in DAYS]
    by_headway = []
    for headway_s in HEADWAYS_S:
        found = Fed(headway_s, plans).row(feeding)
        energies = [found[name] for name in ("cruise", "driving", "timetable", "both")]
        saved = [f"{100.0 * (1.0 - each / found['cruise']):.1f}" for each in energies[1:]]
        by_headway.append([f"{headway_s}", *(f"{each:.1f}" for each in energies), *saved, *cells(found)])
    fed, rows, usual = Fed(SENSITIVE_S, plans), [], 0.0
    for name, variant in variants(feeding):
        try:
            found = fed.row(variant)
        except Infeasible as error:
            rows.append([name, f"does not carry the load, {error.value} V", *[""] * 9])
            continue
        usual = usual or found["both"]
        saved = [
            f"{100.0 * (1.0 - found[each] / found['cruise']):.1f}"
            for each in ("driving", "timetable", "both")
        ]
        change = f"{100.0 * (found['both'] / usual - 1.0):+.1f}"
        rows.append([name, f"{found['both']:.1f}", change, *saved, *cells(found)])
    common = (
        "rails lose kWh",
        "substations lose kWh",
        "squeezed kWh",
        "lowest V",
        "peak MW",
        "of one substation MW",
    )
    saved = ("saved by driving %", "by timetable %", "by both %")
    return "\n".join(
        [
            "## Energy with a DC network",
            "",
            f"`{LINE}`, `{TRAINSET}` {LOAD}, feeding `{FEEDING}`, planned running times, dwells of 30 s,",
            "efficiencies 0.9 and 0.76, auxiliaries 120 kW. Offsets between the directions are tried every",
            f"{OFFSET_S} s: cruise and brake and driving only are means over them, timetable only and both",
            "the best of them. Losses, squeezed energy, voltage and peaks are those of both. Were every",
            f"returned joule received without loss, no timetable could take less than {floor:.1f} kWh.",
            "",
            table(
                (
                    "headway s",
                    "cruise and brake kWh",
                    "driving only kWh",
                    "timetable only kWh",
                    "both kWh",
                    *saved,
                    *common,
                ),
                by_headway,
            ),
            "",
            f"What the assumed numbers are worth, every {SENSITIVE_S} s; change: of the energy of both.",
            "",
            table(("changed", "both kWh", "change %", *saved, *common), rows),
            "",
            f"Days of {DAY_H} h, {PEAKS_H} of them at {PEAK_S} s and the others at {QUIET_S} s, every second",
            "solved. A journey is one train from end to end; planning, done once, is not in the times.",
            "",
            table(
                (
                    "journeys",
                    "seconds",
                    "trains and seconds",
                    "processor s",
                    "wall s",
                    "Newton steps",
                    "imbalance",
                    "lowest V",
                ),
                days,
            ),
            "",
            written("feeding"),
        ]
    )


def measure_stores(fed: Fed, variant: Feeding) -> dict[str, float]:
    """Energies over the offsets, and what storages do at the best of them."""
    kwh = fed.energies_kwh("optimal", variant)
    best = fed.timetable(fed.offsets[int(np.argmin(kwh))])
    flow = feed_line(fed.operation, best, fed.plans["optimal"], variant).flow
    into = np.concatenate([flow.storage_w.ravel(), flow.onboard_w])
    told = FeedingEnergy(variant, flow).as_dict()
    return {
        "mean_kwh": float(kwh.mean()),
        "least_kwh": float(kwh.min()),
        "taken_kwh": float(np.maximum(into, 0.0).sum()) / J_PER_KWH,
        "given_kwh": float(np.maximum(-into, 0.0).sum()) / J_PER_KWH,
        **{name: told[name] for name in ("squeezed_kwh", "lowest_v", "peak_w")},
        "imbalance": abs(float(flow.imbalance)),
    }


def measure_storage(keep: Path | None) -> str:
    """Text of the part on storages.

    Args:
        keep: Folder that keeps what is finished; None: everything is computed.
    """
    fed, rows, usual_kwh = Fed(SENSITIVE_S, planned_profiles(), STORAGE_OFFSET_S), [], 0.0
    for k, (name, variant) in enumerate(stores(load_feeding(FEEDING))):
        compute = partial(measure_stores, fed, variant)
        identity = {"variant": repr(variant), "headway_s": SENSITIVE_S, "offset_s": STORAGE_OFFSET_S}
        found = compute() if keep is None else load_or_compute(keep / f"storage-{k}.json", identity, compute)
        usual_kwh = usual_kwh or found["least_kwh"]
        rows.append(
            [
                name,
                f"{found['mean_kwh']:.1f}",
                f"{found['least_kwh']:.1f}",
                f"{100.0 * (found['least_kwh'] / usual_kwh - 1.0):+.1f}",
                *(f"{found[each]:.1f}" for each in ("taken_kwh", "given_kwh", "squeezed_kwh")),
                f"{found['lowest_v']:.0f}",
                f"{found['peak_w'] / 1e6:.1f}",
                f"{found['imbalance']:.0e}",
            ]
        )
    heads = (
        "storage",
        "mean kWh",
        "best offset kWh",
        "change %",
        "taken kWh",
        "given back kWh",
        "squeezed kWh",
    )
    heads = (*heads, "lowest V", "peak MW", "imbalance")
    text = (
        f"Storages on `{FEEDING}`, every {SENSITIVE_S} s, optimal driving, planned running times, offsets "
        f"every {STORAGE_OFFSET_S} s. Sizes and voltages are assumed: charged above 860 V, discharged below "
        "820 V, 95 % each way."
    )
    return "\n".join([text, "", table(heads, rows), "", written("storage")])


def written(part: str) -> str:
    """Name what wrote a part, where and when."""
    about = "; ".join(f"{k} {v}" for k, v in circumstances(("metropilot", "clarabel", "numpy")).items())
    return f"`python -m benchmarks.feeding --part {part} --write docs/line.md`; {about}."


PARTS = "feeding", "storage"


def main() -> None:
    """Compute one part or both; print the parts of the page or write them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, metavar="PAGE")
    parser.add_argument("--part", choices=PARTS, help="only this part")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep finished rows of storages there")
    given = parser.parse_args()
    if given.part in {None, "feeding"}:
        write_section(given.write, "feeding", measure())
    if given.part in {None, "storage"}:
        write_section(given.write, "network-storage", measure_storage(given.keep))


if __name__ == "__main__":
    main()
