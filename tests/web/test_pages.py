"""Parts of the pages, without a browser."""

import asyncio
import gc
import math
import tomllib

import pytest
from nicegui import Client, core, ui
from nicegui.page import page
from starlette.requests import Request

from metropilot._schema import field_default, field_specs
from metropilot.convoy import ConvoyRequest, Link
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.evaluate import SERIES_STYLES, RunSpec, driver_styles
from metropilot.operation import OperationOptions, SlowSection, TrainHold
from metropilot.railway import Restriction, document_text, parse_document, toml_text
from metropilot.sim import Disturbance, TimetableUpdate
from metropilot.units import KINDS
from metropilot.web.errors import Refused
from metropilot.web.live.session import Session
from metropilot.web.pages import journey as journeys
from metropilot.web.pages import operation as operations
from metropilot.web.pages.compare import ComparePage, outcome
from metropilot.web.pages.convoy import ConvoyPage, member_outcome
from metropilot.web.pages.document import grid_of
from metropilot.web.pages.drive import DrivePage
from metropilot.web.pages.fit import FitPage
from metropilot.web.pages.form import describe_range, validate
from metropilot.web.pages.frame import frame
from metropilot.web.pages.journey import JourneyPage
from metropilot.web.pages.numbers import NumberField
from metropilot.web.pages.operation import OperationPage
from metropilot.web.pages.plots import (
    compare_figure,
    convoy_figure,
    finished_convoy_figure,
    finished_line_figure,
    front_figure,
    headways_figure,
    running_figure,
)
from metropilot.web.pages.runs import RunList, RunsPage
from metropilot.web.schemas.requests import (
    CampaignIn,
    ConvoyIn,
    DriveIn,
    FitIn,
    JourneyIn,
    LearnIn,
    NewLink,
    OperationIn,
    RunningLineIn,
)
from metropilot.web.service import Service
from metropilot.web.settings import Settings


@pytest.mark.parametrize(
    ("kind", "name", "scale", "words"),
    [
        (DriveIn, "mass_factor", 1.0, "0.5 to 2"),
        (DriveIn, "seed", 1.0, "0 or more"),
        (LearnIn, "steps", 1.0, "1 000 to 50 000 000"),
        (LearnIn, "seed", 1.0, "0 to below 2 147 483 648"),
        (JourneyIn, "total_s", 1.0, "above 0 to 36 000"),
        (NewLink, "loss", 100.0, "0 to 100"),
    ],
)
def test_a_field_says_what_its_request_allows(kind, name, scale, words):
    assert describe_range(kind, name, scale) == words


@pytest.mark.parametrize(
    ("kind", "values", "scales", "told"),
    [
        (DriveIn, {"mass_factor": 0}, {}, ("mass_factor", 0, "0.5 to 2")),
        (ConvoyIn, {"trainsets": 1}, {}, ("trainsets", 1, "2 to 6")),
        (NewLink, {"loss": 1.2}, {"loss": 100.0}, ("loss", 120, "0 to 100")),
    ],
)
def test_what_is_not_allowed_is_refused_in_one_line(kind, values, scales, told):
    with pytest.raises(InputError) as refused:
        validate(kind, values, **scales)
    error = refused.value
    assert (error.field, error.value, error.allowed) == (told[0], pytest.approx(told[1]), told[2])
    assert "\n" not in str(error)


def test_a_form_shows_what_is_declared(monkeypatch, tmp_path):
    """Every field has the label, unit, step, range and default of the declaration that also checks it."""
    shown, make = {}, NumberField.__init__

    def record(self, label, **more):
        make(self, label=label, **more)
        assert shown.setdefault(label, self) is self

    monkeypatch.setattr(NumberField, "__init__", record)

    async def build():
        core.loop = asyncio.get_running_loop()
        service = Service(Settings(tmp_path))
        scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
        with Client(page("/form"), request=Request(scope)):
            DrivePage(service, None).build_news()
            ConvoyPage(service, None).build()
            OperationPage(service, None).build()

    asyncio.run(build())
    defaults = {"count": 3, "from_m": 700.0, "to_m": 900.0, "limit_mps": 40 / 3.6, "scheduled_time_s": 101.0}
    shown.pop("Seed of the search")
    kinds = (Disturbance, Restriction, TimetableUpdate, Link, ConvoyRequest, OperationOptions, RunSpec)
    for kind in (*kinds, TrainHold, SlowSection):
        for name, spec in field_specs(kind).items():
            if not spec.label or spec.range is None:
                continue
            unit = KINDS["share"]["%"] if name == "loss" else spec.shown_unit
            field = shown.pop(f"{spec.label} ({unit.name})" if unit else spec.label)
            displayed = unit.from_si if unit else float
            hint = field.props["hint"].replace(" ", "")
            assert f"{displayed(spec.range.low):.10g}" in hint, name
            if spec.range.high < 1e9 and name not in {"count", "zones"}:  # those of server and line
                assert f"{displayed(spec.range.high):.10g}" in hint, name
            assert field.props["step"] == pytest.approx(displayed(spec.step)), name
            own = {} if kind is SlowSection else defaults
            default = own.get(name, field_default(kind, name))
            value = (
                None
                if default is None or default == float("inf")
                else pytest.approx(displayed(float(default)))
            )
            assert field.value == value, name
    assert shown == {}


def test_half_a_trainset_is_refused():
    with pytest.raises(InputError, match="trainsets"):
        validate(ConvoyIn, {"trainsets": 2.5})


def entry(name):
    columns = {"position_m": [0], "limit_mps": [9.0], "speed_mps": [0.0], "energy_wheel_j": [0.0]}
    kpis = {"outcome": "arrived", "running_time_s": 101.0, "energy_wheel_kwh": 9.0}
    return {"driver": name, "drive": {"columns": columns, "plan": None, "kpis": kpis}}


def test_a_driver_has_one_colour_in_every_picture():
    names = [f"driver_{k}" for k in range(12)]
    entries = [entry(name) for name in names]
    front = {"time_s": [90.0], "energy_j": [1.0], "minimum_running_time_s": 83.0}
    on_front = {
        t["name"]: t["marker"]["color"] for t in front_figure(front, (95.0, 1.0), entries)["data"][2:]
    }
    lines = {t["name"]: t["line"]["color"] for t in compare_figure(entries)["data"] if t["name"] in names}
    printed = {name: colour for name, (colour, _) in driver_styles(names).items()}
    assert on_front == lines == printed
    assert len(set(driver_styles(names).values())) == len(names)
    gaps = [t["line"]["color"] for t in convoy_figure()["data"][:5]]
    assert gaps == [colour for colour, _ in SERIES_STYLES[:5]]


def test_a_line_that_is_over_is_drawn_as_it_was():
    graph = {
        "stops": [{"code": "A", "position_m": 0.0}, {"code": "B", "position_m": 2000.0}],
        "time_s": [60.0, 120.0],
        "position_m": [[0.0, 500.0, 900.0], [300.0, 700.0, 900.0]],
        "delay_s": [[0.0, 0.0, 0.0], [-3.0, 20.0, 80.0]],
        "energy_kwh": [1.0, 2.0],
        "floor_kwh": [0.5, 1.5],
    }
    drawn = finished_line_figure(graph)
    paths = [(trace["x"], trace["y"]) for trace in drawn["data"][:3]]
    assert [x for x, _ in paths] == [[1.0, 2.0, None]] * 3
    assert [y for _, y in paths] == [[0.0, 0.3, None], [0.5, 0.7, None], [0.9, 0.9, None]]
    late, energy, floor, trains = ((trace["x"], trace["y"]) for trace in drawn["data"][3:])
    assert late == ([1.0, 2.0], [0.0, 100 / 60])
    assert (energy[1], floor[1]) == ([1.0, 2.0], [0.5, 1.5])
    assert trains == ([2.0] * 3, [0.3, 0.7, 0.9])
    assert drawn["layout"]["yaxis"]["ticktext"] == ["A", "B"]
    empty = {name: [] for name in graph}
    assert all(trace["x"] == [] for trace in finished_line_figure(empty)["data"])


def test_a_driver_has_one_colour_in_every_comparison():
    usual = ["optimal", "manual", "flat_out", "ppo", "mpc", "pid"]
    every = [*DRIVERS.ids(), "pid:kp=3", "learned:policy=ppo-20260101-120000-ab12"]
    styles = driver_styles(every)
    assert len(set(styles.values())) == len(every)
    assert len({styles[name][0] for name in usual}) == len(usual)
    assert driver_styles(every[::-1]) == styles
    for name in every:
        assert driver_styles([name]) == {name: styles[name]}
        assert driver_styles([name, "optimal"])[name] == styles[name]
    on_front = front_figure(
        {"time_s": [90.0], "energy_j": [1.0], "minimum_running_time_s": 83.0},
        (95.0, 1.0),
        [*map(entry, every)],
    )["data"][2:]
    assert len({(t["marker"]["color"], t["marker"]["symbol"]) for t in on_front}) == len(every)


def test_a_convoy_of_an_earlier_server_is_drawn_whole():
    speeds = [{"time_s": [0.0, 1.0], "speed_mps": [0.0, 10.0]}] * 3
    gaps = {"gap_m": [[6.0, 7.0], [6.5, 7.5]], "speed_difference_mps": [[0.0, 0.1], [0.0, 0.2]]}
    drawn = finished_convoy_figure({"time_s": [0.0, 1.0], "speeds": speeds, **gaps})["data"]
    assert [list(t["y"]) for t in drawn[:3]] == [[6.0, 6.5], [7.0, 7.5], []]
    assert list(drawn[7]["y"]) == pytest.approx([0.36, 0.72])
    assert [list(t["y"]) for t in drawn[12:16]] == [[0.0, 36.0]] * 3 + [[]]
    assert [t["showlegend"] for t in drawn[12:16]] == [True, True, True, False]


def test_a_figure_without_values_has_no_made_up_numbers_on_its_axes():
    (words,) = headways_figure({}, 180.0)["layout"]["annotations"]
    assert words["text"] == "No headway is computed yet."
    assert convoy_figure()["layout"]["xaxis"]["rangemode"] == "tozero"
    running = running_figure()["layout"]
    assert (running["xaxis"]["range"], running["yaxis"]["tickvals"]) == ([0, 10], [])
    state = {"energy_kwh": [0.0, 1.0], "floor_kwh": [0.0, 1.0], "delay_s": [[0.0], [0.0]]}
    stops = [{"position_m": 0.0, "code": "A"}, {"position_m": 900.0, "code": "B"}]
    drawn = finished_line_figure(
        {"time_s": [0.0, 1200.0], "position_m": [[0.0], [900.0]], "stops": stops, **state}
    )
    assert drawn["layout"]["xaxis"]["range"] == [0.0, 20.0]
    assert drawn["layout"]["yaxis"]["ticktext"] == ["A", "B"]


def test_what_is_under_way_for_a_page_ends_with_it():
    async def leave():
        core.loop = asyncio.get_running_loop()
        scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
        request = Request(scope)
        clients = [Client(page("/left"), request=request) for _ in range(2)]
        for client in clients:
            with client, frame(request, "/"):
                ui.label("there")

        async def work(client):
            with client:
                await asyncio.sleep(0.3)
                ui.label("late")

        tasks = [asyncio.create_task(work(client)) for client in clients]
        await asyncio.sleep(0)
        clients[0].delete()
        await asyncio.wait(tasks)
        clients[1].delete()
        return [task.cancelled() for task in tasks]

    assert asyncio.run(leave()) == [True, False]


def test_a_resumed_run_is_opened_though_the_list_was_drawn_anew(tmp_path, monkeypatch):
    opened = []

    async def resume():
        core.loop = asyncio.get_running_loop()
        service = Service(Settings(tmp_path))
        scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
        client = Client(page("/runs"), request=Request(scope))
        monkeypatch.setattr(client, "open", lambda path, new_tab=False: opened.append(path))
        with client:
            listed = RunList(service, None)
            listed.build()
            with listed.rows, ui.element("div"):
                slot = ui.button("Resume").parent_slot

        async def resume_slowly(_):
            listed.rows.clear()
            gc.collect()

        monkeypatch.setattr(service, "resume_live", resume_slowly)
        with slot:  # where the handler of the click runs
            await listed.resume("live-1", "/?run=live-1")

    asyncio.run(resume())
    assert opened == ["/?run=live-1"]


def on_page(story, tmp_path):
    """Result of a coroutine of a service, on a page."""

    async def tell():
        core.loop = asyncio.get_running_loop()
        scope = {"type": "http", "method": "GET", "path": "/", "headers": [], "query_string": b""}
        with Client(page("/shown"), request=Request(scope)):
            return await story(Service(Settings(tmp_path)))

    return asyncio.run(tell())


@pytest.mark.parametrize("kind", [ConvoyPage, DrivePage])
def test_a_run_that_waits_is_stopped_and_takes_another_pace(kind, tmp_path):
    async def story(service):
        shown = kind(service, None)
        shown.build()
        told = []
        session = Session("live-1", {"pace": 20.0}, {}, lambda *words: told.append(words[1:]), lambda: None)
        service.sessions["live-1"], shown.run = session, "live-1"
        await shown.change_pace()
        await shown.stop()
        return told

    assert on_page(story, tmp_path) == [("end", {"status": "stopped", "error": None})]


def test_a_job_interrupted_by_a_restart_is_not_waited_for(tmp_path):
    async def story(service):
        fit = service.store.new_job("fit", FitIn(logs=["upload-00000000"]).model_dump())
        line = service.store.new_job("line", OperationIn().model_dump())
        for job in (fit, line):
            service.store.update(job, status="interrupted")
        fitted, shown = FitPage(service, fit, None), OperationPage(service, line)
        fitted.build()
        fitted.look()
        shown.build()
        shown.load()
        return fitted.going, fitted.go.enabled, shown.jobs, shown.status.text

    assert on_page(story, tmp_path) == (False, True, [], "")


def test_a_job_that_was_deleted_elsewhere_is_told_once(tmp_path):
    async def story(service):
        shown = OperationPage(service, None)
        shown.build()
        shown.load()
        shown.jobs.append("line-1")
        shown.look()
        return shown.jobs, shown.problem.label.text

    jobs, told = on_page(story, tmp_path)
    assert jobs == []
    assert "no such job" in told


def test_a_drive_on_time_that_failed_something_else_is_not_called_late():
    kpis = {"time_error_s": {"mean": 0.1}}
    entry = {"successes": 0, "seeds": 1, "outcomes": ["arrived"], "ended": ["arrived, jerk"], "kpis": kpis}
    assert outcome(entry) == ("✗ arrived, jerk", "mp-fail")
    assert outcome(entry | {"successes": 1}) == ("✓ on time", "mp-pass")


def test_a_trainset_of_a_convoy_says_what_it_failed():
    assert member_outcome({"outcome": "arrived", "failed": ["jerk"]}) == ("✗ arrived: jerk", "mp-fail")
    assert member_outcome({"outcome": "arrived", "failed": []}) == ("✓ arrived", "mp-pass")


def test_a_form_answers_changes_by_hand_after_one_that_failed(tmp_path, monkeypatch):
    async def story(service):
        shown = DrivePage(service, None)
        shown.build()

        def fail(*_):
            raise ValueError("gone")

        monkeypatch.setattr(shown.form.restrictions, "rows", [None])
        monkeypatch.setattr(shown.form.restrictions, "move", fail)
        with pytest.raises(ValueError, match="gone"):
            await shown.form.move_restriction(0, {})
        monkeypatch.undo()
        shown.form.linked = True
        shown.form.trainset_in.value = "cheng2023"
        return shown.form.linked

    assert on_page(story, tmp_path) is False


def test_a_running_line_that_stopped_says_so(tmp_path):
    async def story(service):
        run = service.store.new_job("live", RunningLineIn().model_dump())
        service.store.update(run, status="stopped")
        shown = OperationPage(service, None, run)
        shown.build()
        shown.load()
        return shown.running.status.text, shown.running.resume_button.visible

    assert on_page(story, tmp_path) == ("stopped; it can be resumed", True)


def test_the_address_of_a_running_line_stays_beside_that_of_a_result(tmp_path, monkeypatch):
    told = []

    async def story(service):
        shown = OperationPage(service, None)
        shown.build()
        shown.running.run = "live-1"
        shown.found = {180: ("line-1", {"files": []})}
        monkeypatch.setattr(shown, "show_energies", lambda *_, **__: None)
        monkeypatch.setattr(shown, "draw_curve", lambda _: None)
        monkeypatch.setattr(ui, "run_javascript", told.append)
        shown.show()

    on_page(story, tmp_path)
    assert told == ["history.replaceState(null, '', '/line?job=line-1&run=live-1')"]


def test_errors_of_a_linked_line_are_shown(tmp_path):
    async def story(service):
        failed = service.store.new_job("line", OperationIn().model_dump())
        service.store.update(failed, status="failed", error={"message": "too many trains"})
        words = []
        for job, run in ((failed, None), ("line-0", None), (None, "live-0")):
            shown = OperationPage(service, job, run)
            shown.build()
            shown.load()
            words.append(shown.problem.label.text)
        return words

    failed, *gone = on_page(story, tmp_path)
    assert failed == "too many trains"
    assert gone == ["id: no such job: line-0", "id: no such job: live-0"]


def test_runs_of_a_project_that_is_gone_say_so(tmp_path):
    async def story(service):
        shown = RunsPage(service, {"project": "nope"})
        shown.build()
        return shown.problem.label.text

    assert on_page(story, tmp_path) == "project: no such project: nope"


def test_updates_of_a_page_leave_its_sliders_where_they_are(tmp_path):
    """A value among the properties would be set anew at every update."""

    async def story(service):
        DrivePage(service, None).build()
        return [
            each.props
            for each in ui.context.client.elements.values()
            if each.tag == "input" and each.props.get("type") == "range"
        ]

    sliders = on_page(story, tmp_path)
    assert len(sliders) == 2
    assert not any("value" in props for props in sliders)


@pytest.mark.parametrize(
    ("kind", "values", "told"),
    [
        (
            DriveIn,
            {"options": {"a": math.nan}},
            "options.a: wrong kind of value: 'nan' (allowed: true or false",
        ),
        (
            DriveIn,
            {"restrictions": [{"from_m": None}]},
            "restrictions[0].from_m: not a number (allowed: a number",
        ),
        (DriveIn, {"seed": 1.5}, "seed: not a whole number: 1.5 (allowed: 0 or more)"),
        (LearnIn, {"steps": 1e30}, "steps: not a whole number: 1e+30 (allowed: 1 000 to 50 000 000)"),
        (LearnIn, {"budget": "long"}, "budget: unknown value: 'long' (allowed: quick or paper)"),
        (
            CampaignIn,
            {"name": "a", "matrix": {"drivers": ["manual"], "sections": ["yizhuang"], "times": [0.5]}},
            "matrix.times[0]: out of range: 0.5 (allowed: planned or >= 1.0)",
        ),
        (CampaignIn, {"name": "a", "matrix": {"drivers": ["manual"]}}, "matrix.sections: missing"),
    ],
)
def test_a_refusal_names_the_field_its_value_and_what_is_allowed(kind, values, told):
    with pytest.raises(InputError) as refused:
        validate(kind, values)
    assert str(refused.value).startswith(told)


def test_a_field_that_was_emptied_shows_the_number_it_stands_for(tmp_path):
    async def story(service):
        shown = DrivePage(service, None)
        shown.build()
        fields = shown.disturbances.inputs
        for field in fields.values():
            field.value = None
            field.sanitize()
        return {name: field.value for name, field in fields.items()}

    values = on_page(story, tmp_path)
    assert (values["seed"], values["headwind_mps"], values["mass_factor"]) == (0, 0.0, 1.0)


def test_a_row_of_a_campaign_that_is_no_number_is_refused_on_the_page(tmp_path):
    async def story(service):
        with pytest.raises(Refused) as refused:
            DrivePage(service, None).row_request("leaderboard", "abc")
        return str(refused.value)

    assert on_page(story, tmp_path) == "row: no such row: 'abc' (allowed: a whole number)"


def test_a_journey_of_stations_by_name_is_shown(tmp_path):
    async def story(service):
        shown = JourneyPage(service, None)
        shown.build()
        shown.restore(JourneyIn(origin="Rongjing East Street", destination="XHM").model_dump())
        return shown.fields["origin"].value, shown.fields["destination"].value

    assert on_page(story, tmp_path) == ("RJ", "XHM")


@pytest.mark.parametrize("least_j", [0.0, -3.6e6])
def test_a_journey_downhill_without_energy_is_shown_without_shares(least_j, tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(journeys.parts, "reads", told.extend)
    for name in ("journey_figure", "sections_figure"):
        monkeypatch.setattr(journeys, name, lambda _: {})
    found = {"energy_j": least_j, "bound_j": least_j, "planned_energy_j": least_j, "running_time_s": 90.0}

    async def story(service):
        shown = JourneyPage(service, None)
        shown.build()
        shown.show(found | {"calls": []})

    on_page(story, tmp_path)
    assert [value for _, value, _ in told[2:]] == ["–", "–"]


def test_the_next_second_of_a_plan_without_energy_has_no_share(tmp_path):
    async def story(service):
        shown = ComparePage(service, None)
        shown.build()
        shown.say_second(90.0, {"energy_j": 0.0, "second_w": 3.6e3, "certificate_gap": 0.0})
        return shown.words.text

    assert "saves 1 Wh, – %" in on_page(story, tmp_path)


def test_energies_of_a_line_that_returns_all_are_shown_without_shares(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(operations.parts, "reads", told.extend)
    monkeypatch.setattr(operations, "operation_figure", lambda *_, **__: {})
    monkeypatch.setattr(operations.parts, "table", lambda _, rows, **__: told.extend(rows))
    energies = {"line": "hill", "headway_s": 180.0, "feeding": {}, "fleet": 2, "peak_minute_w": 0.0}
    energies |= {"energy_kwh": 1.0, "cruise_kwh": 0.0, "floor_kwh": -1.0, "gap_percent": None}
    energies |= {"returned_kwh": 0.0, "unreceived_kwh": 0.0}

    async def story(service):
        shown = OperationPage(service, None)
        shown.show_energies({"energies": energies, "bottleneck": None, "graph": {}}, day=False)

    on_page(story, tmp_path)
    assert [value for _, value, _ in told[2:4]] == ["–", "–"]
    assert [row[3:] for row in told[6:]] == [("–", "–")] * 3


def test_a_load_without_a_mass_is_refused_by_name():
    document = tomllib.loads(document_text("trainset", "dkz32"))
    grid = grid_of("mass", "loads", document["mass"]["loads"], {})
    document["mass"]["loads"] = grid.put([["AW0", None], ["AW2", 250.0]])
    with pytest.raises(InputError, match=r"mass\.loads\.AW0: must be a number"):
        parse_document(toml_text(document), None)
