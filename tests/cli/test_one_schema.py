"""One declaration of a run: every entry gives every field of it, and refuses it in the same words."""

import asyncio
from dataclasses import fields, replace

import httpx
import pytest
from fastapi import FastAPI

from metropilot._schema import field_specs, field_type
from metropilot.campaign import campaign_from_toml, case_request
from metropilot.cli import app
from metropilot.convoy import CONVOY_PERIOD_S, FOLLOWERS, ConvoyRequest, Link
from metropilot.drivers import DRIVERS
from metropilot.errors import InputError
from metropilot.evaluate import (
    RunSpec,
    option_class,
    option_defaults,
    run_fields,
    run_from_toml,
    with_options,
)
from metropilot.railway import Restriction
from metropilot.sim import Disturbance, TimetableUpdate
from metropilot.web import ConvoyIn, DriveIn, Service, Settings, install
from metropilot.web import request_of as request_of_body

WHERE = {"line": "yizhuang", "origin": "RJ", "destination": "WYJ"}
NUMBERS = [name for name, spec in field_specs(Disturbance).items() if spec.range is not None]
VALUES = dict(zip(NUMBERS, (1.2, 1.5, 0.6, 0.4, 0.05, -8.0, 0.07, 0.8), strict=True))
GIVEN = [(name, value, Disturbance(**{name: value})) for name, value in VALUES.items()]
LIMIT = Restriction(400.0, 600.0, 40.0 / 3.6)


@pytest.fixture
def service(tmp_path):
    """Service behind the HTTP API."""
    return Service(Settings(tmp_path))


class Caught(Exception):
    """The run that a command would drive."""


@pytest.fixture
def from_command_line(monkeypatch):
    """The run that `metropilot drive`, or `convoy`, makes of its options."""

    def tell(spec, *_, **__):
        raise Caught(spec)

    def read(*options, command="drive"):
        monkeypatch.setattr(f"metropilot.cli.{command}.run_and_report", tell)
        with pytest.raises(Caught) as told:
            app._run([command, *WHERE.values(), *options])
        return told.value.args[0]

    return read


def option(name):
    """A field's option as it is written."""
    return f"--{run_fields()[name].option or app.UNIT.sub('', name).replace('_', '-')}"


def run_file(folder, text):
    """A `run.toml` with this line."""
    path = folder / "run.toml"
    path.write_text("[run]\n" + "".join(f'{k} = "{v}"\n' for k, v in WHERE.items()) + text)
    return path


def campaign_file(folder, text):
    """A campaign of one run with this line in its disturbance."""
    path = folder / "campaign.toml"
    matrix = '[matrix]\ndrivers = ["flat_out"]\nsections = ["yizhuang RJ WYJ"]\nloads = ["AW0"]\n'
    path.write_text(f'name = "one"\n{matrix}[[disturbance]]\nname = "it"\n{text}\n')
    return path


def of_campaign(path, scheduled_s=100.0, length_m=1000.0):
    """The only run of a campaign."""
    campaign = campaign_from_toml(path)
    return case_request(campaign, campaign.case(0), scheduled_s, length_m)


def of_body(values):
    """The run that the HTTP API makes of a body."""
    return request_of_body(DriveIn.model_validate(WHERE | values), lambda _, key: key)


@pytest.mark.parametrize(("name", "value", "disturbance"), GIVEN, ids=VALUES)
def test_every_entry_gives_every_disturbance(tmp_path, from_command_line, name, value, disturbance):
    assert from_command_line(f"{option(name)}={value}").disturbance == disturbance
    assert run_from_toml(run_file(tmp_path, f"{name} = {value}")).disturbance == disturbance
    assert of_body({name: value}).disturbance == disturbance
    assert of_campaign(campaign_file(tmp_path, f"{name} = {value}")).disturbance == disturbance


def test_every_entry_gives_ideal_actuation(tmp_path, from_command_line):
    ideal = Disturbance(ideal=True)
    assert from_command_line("--ideal").disturbance == ideal
    assert run_from_toml(run_file(tmp_path, "ideal = true")).disturbance == ideal
    assert of_body({"ideal": True}).disturbance == ideal
    assert of_campaign(campaign_file(tmp_path, "ideal = true")).disturbance == ideal


@pytest.mark.parametrize("at_s", [None, 30.0])
def test_every_entry_gives_a_restriction(tmp_path, from_command_line, at_s):
    text = "400-600@40" + ("" if at_s is None else "@30")
    body = {"from_m": 400.0, "to_m": 600.0, "limit_mps": 40.0 / 3.6, "at_s": at_s}
    share = "restriction = {from = 0.4, to = 0.6, kmh = 40" + ("}" if at_s is None else ", announced = 0.3}")
    found = [
        from_command_line(f"--restriction={text}"),
        run_from_toml(run_file(tmp_path, f'restrictions = ["{text}"]')),
        of_body({"restrictions": [body]}),
        of_campaign(campaign_file(tmp_path, share)),
    ]
    update = TimetableUpdate(30.0, restriction=LIMIT)
    for spec in found:
        assert spec.restrictions == ((LIMIT,) if at_s is None else ())
        assert spec.disturbance.updates == (() if at_s is None else (update,))
        assert spec.values()["restrictions"] == [text]


def test_every_entry_gives_a_new_arrival_time(tmp_path, from_command_line):
    found = [
        from_command_line("--arrive=116@30"),
        run_from_toml(run_file(tmp_path, 'arrivals = ["116@30"]')),
        of_body({"arrivals": [{"scheduled_time_s": 116.0, "at_s": 30.0}]}),
        of_campaign(campaign_file(tmp_path, "arrival = {factor = 1.16, announced = 0.3}")),
    ]
    for spec in found:
        assert spec.disturbance.updates == (TimetableUpdate(30.0, scheduled_time_s=116.0),)
        assert spec.values()["arrivals"] == ["116@30"]


@pytest.mark.parametrize("name", NUMBERS)
def test_every_entry_refuses_in_the_same_words(tmp_path, metropilot, name):
    bound = field_specs(Disturbance)[name].range
    value = bound.low - 1.0
    with pytest.raises(InputError) as refused:
        Disturbance(**{name: value})
    said = refused.value.line().removeprefix(name)
    typed = metropilot("drive", *WHERE.values(), f"{option(name)}={value}")
    assert (typed.code, typed.err) == (2, f"metropilot: {option(name)}{said}\n")
    path = run_file(tmp_path, f"{name} = {value}")
    read = metropilot("drive", "--from", path)
    assert (read.code, read.err) == (2, f"metropilot: {path}: run.{name}{said}\n")
    with pytest.raises(InputError) as in_campaign:
        campaign_from_toml(path := campaign_file(tmp_path, f"{name} = {value}"))
    assert in_campaign.value.line() == f"{path}: disturbance it.{name}{said}"
    error = read_error({name: value})
    shown = InputError(error.pop("message"), **error).line()
    assert shown == f"{name}{said}"


def read_error(values, body=DriveIn):
    """The error that the HTTP API answers a body with."""
    server = FastAPI()
    install(server)

    @server.post("/drive")
    def drive(asked: body) -> None:
        """Take a body."""

    async def post():
        transport = httpx.ASGITransport(app=server)
        async with httpx.AsyncClient(transport=transport, base_url="http://here") as client:
            return await client.post("/drive", json=WHERE | values)

    answer = asyncio.run(post())
    assert answer.status_code == 422
    return answer.json()["error"]


def test_a_run_reads_back_as_it_was_written():
    spec = RunSpec(
        **WHERE,
        options={"reserve_s": 1},
        restrictions=(LIMIT,),
        disturbance=Disturbance(
            ideal=True,
            **VALUES,
            updates=(
                TimetableUpdate(12.25, restriction=Restriction(0.1, 1e3, 65 / 3.6)),
                TimetableUpdate(20.0, scheduled_time_s=116.5),
            ),
        ),
    )
    assert RunSpec.from_values(spec.values()) == spec


def convoy_of_body(service, values):
    """The convoy that the HTTP API makes of a body."""
    return service._convoy(ConvoyIn.model_validate(WHERE | {"trainsets": 2, "time_s": 130.0} | values))


def typed_convoy(request):
    """A request as HTTP defaults it: two trainsets, 130 s."""
    return replace(request, head=replace(request.head, time_s=130.0))


@pytest.mark.parametrize(("name", "value", "disturbance"), GIVEN, ids=VALUES)
def test_every_entry_gives_a_convoy_every_disturbance(service, from_command_line, name, value, disturbance):
    typed = typed_convoy(from_command_line(f"{option(name)}={value}", command="convoy"))
    assert typed.head.disturbance == disturbance
    assert [typed.convoy().disturbance(k) for k in range(2)] == [disturbance] * 2
    assert ConvoyRequest.from_values(typed.values()) == typed
    assert convoy_of_body(service, {name: value}) == typed


def test_every_entry_gives_a_convoy_its_link_and_gaps(service, from_command_line):
    given = {"link_delay_s": 0.3, "link_jitter_s": 0.2, "link_loss": 0.1, "gap_m": 7.0, "emergency_s": 40.0}
    options = ("--link-delay=0.3", "--link-jitter=0.2", "--link-loss=0.1", "--gap=7", "--head-emergency=40")
    typed = typed_convoy(from_command_line(*options, command="convoy"))
    assert (typed.link, typed.gap_m, typed.emergency_s) == (Link(0.3, 0.2, 0.1), 7.0, 40.0)
    assert ConvoyRequest.from_values(typed.values()) == typed
    assert convoy_of_body(service, given) == typed


def test_every_entry_gives_a_convoy_its_own_period(service, from_command_line):
    """A run.json without the period, and values in Python, took that of a single run."""
    typed = from_command_line(command="convoy")
    assert typed.head.dt_s == convoy_of_body(service, {}).head.dt_s == CONVOY_PERIOD_S
    head = typed.head.values() | {"dt_s": None}
    assert ConvoyRequest.from_values({"head": head}).convoy().dt == CONVOY_PERIOD_S
    assert ConvoyRequest.from_values({"head": head | {"dt_s": 0.2}}).convoy().dt == 0.2


def test_each_trainset_of_a_convoy_may_have_its_own_disturbance(service, from_command_line):
    typed = typed_convoy(from_command_line("--mass-factors=1,1.2", "--lag=0.4", command="convoy"))
    own = [Disturbance(lag_s=0.4), Disturbance(lag_s=0.4, mass_factor=1.2)]
    assert [typed.convoy().disturbance(k) for k in range(2)] == own
    assert ConvoyRequest.from_values(typed.values()) == typed
    each = [{"lag_s": 0.4}, {"lag_s": 0.4, "mass_factor": 1.2}]
    assert convoy_of_body(service, {"lag_s": 0.4, "disturbances": each}) == typed


@pytest.mark.parametrize("name", ["mass_factor", "delay_s", "link_delay_s", "link_loss", "gap_m"])
def test_every_entry_of_a_convoy_refuses_in_the_same_words(metropilot, name):
    error = read_error({name: -1.0}, ConvoyIn)
    said = InputError(error.pop("message"), **error).line().removeprefix(name)
    own = f"--{name.removesuffix('_s').removesuffix('_m').replace('_', '-')}"
    typed = metropilot("convoy", *WHERE.values(), f"{own}=-1")
    assert (typed.code, typed.err) == (2, f"metropilot: {own}{said}\n")


@pytest.mark.parametrize(("name", "beyond"), [("from_m", -1.0), ("to_m", 2e5 + 1), ("limit_mps", 1.0)])
def test_http_refuses_a_restriction_in_the_words_of_its_declaration(name, beyond):
    values = {"from_m": 400.0, "to_m": 600.0, "limit_mps": 9.0} | {name: beyond}
    with pytest.raises(InputError) as refused:
        Restriction(**values)
    error = read_error({"restrictions": [values]})
    assert InputError(error.pop("message"), **error).line() == f"restrictions[0].{refused.value.line()}"


@pytest.mark.parametrize(("name", "beyond"), [("at_s", 36_001.0), ("scheduled_time_s", 0.0)])
def test_http_refuses_a_timetable_update_in_the_words_of_its_declaration(name, beyond):
    with pytest.raises(InputError) as refused:
        TimetableUpdate(**{"at_s": 30.0, "scheduled_time_s": 116.0} | {name: beyond})
    error = read_error({"arrivals": [{"at_s": 30.0, "scheduled_time_s": 116.0} | {name: beyond}]})
    assert InputError(error.pop("message"), **error).line() == f"arrivals[0].{refused.value.line()}"


def test_an_announcement_too_late_is_refused(metropilot):
    typed = metropilot("drive", *WHERE.values(), "--arrive=99999@36001")
    assert typed.err == "metropilot: --arrive: out of range: 36001.0 s (allowed: 0 to 36000 s)\n"
    assert typed.code == 2


OPTIONS = sorted({kind for r in (DRIVERS, FOLLOWERS) for d in r if (kind := option_class(r.get(d)))}, key=str)


@pytest.mark.parametrize("kind", OPTIONS, ids=lambda kind: kind.__name__)
def test_every_option_of_a_driver_declares_what_it_may_be(kind):
    specs = field_specs(kind)
    assert list(specs) == [f.name for f in fields(kind)]
    for name, spec in specs.items():
        if field_type(kind, name) in {int, float}:
            assert spec.range is not None, name
            outside = [float("nan"), spec.range.low if spec.range.above else spec.range.low - 1.0]
            outside += [] if spec.range.infinite else [spec.range.high + 1.0, float("inf")]
            for value in outside:
                with pytest.raises(InputError, match=f"^{name}: out of range: .* .allowed: "):
                    kind(**{name: value})


@pytest.mark.parametrize("registry", [DRIVERS, FOLLOWERS], ids=["drivers", "followers"])
def test_every_driver_takes_the_defaults_of_its_options(registry):
    for name in registry:
        driver = registry.get(name)
        if defaults := option_defaults(driver):
            assert isinstance(with_options(driver, defaults), driver)


@pytest.mark.parametrize(
    ("driver", "given", "allowed"),
    [
        ("pid", "kp=-1", "0 to 100"),
        ("fuzzy_pid", "ki=2", "0 to 1.5"),
        ("neural_pid", "momentum=1.5", "0 to 1"),
        ("optimal", "alarm=0", "> 0 and <= 10"),
        ("eitoe", "start_mps2=2.5", "> 0 m/s^2 and <= 2 m/s^2"),
    ],
)
def test_a_driver_refuses_an_option_in_one_line(metropilot, driver, given, allowed):
    name, value = given.split("=")
    typed = metropilot("drive", *WHERE.values(), "--driver", driver, "--set", given)
    unit = " m/s^2" if name.endswith("mps2") else ""
    told = f"metropilot: --set {name}: out of range: {float(value)}{unit} (allowed: {allowed})\n"
    assert (typed.code, typed.err) == (2, told)
