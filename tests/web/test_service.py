"""Jobs of the service, without processes: queued once, stopped for good, watched to the end."""

import asyncio
import inspect
import logging
from concurrent.futures import Future
from pathlib import Path
from typing import get_args

import pytest

from metropilot.campaign import CampaignStore, campaign_from_values, compute_shard
from metropilot.cli.convoy import convoy_command
from metropilot.errors import InputError
from metropilot.railway import load_line
from metropilot.web import catalogue, evidence
from metropilot.web import service as services
from metropilot.web.errors import Refused
from metropilot.web.kinds import JOB_KINDS
from metropilot.web.schemas.requests import CampaignIn, ConvoyIn, DriveIn, FitIn, JourneyIn, OperationIn
from metropilot.web.schemas.responses import JobKind
from metropilot.web.server import is_news
from metropilot.web.service import Service
from metropilot.web.settings import Settings
from metropilot.web.store import JobStore, outcome_words
from metropilot.web.work import campaigns
from metropilot.web.work.learning import PROGRESS


@pytest.fixture
def service(tmp_path, monkeypatch):
    """A service whose jobs wait for ever."""
    made = Service(Settings(data=tmp_path))
    made.submitted = []
    monkeypatch.setattr(made.pools, "submit", lambda *work, **_: made.submitted.append(work) or Future())
    return made


def test_every_kind_of_jobs_that_the_api_names_is_one_row():
    assert tuple(JOB_KINDS) == get_args(JobKind)
    assert len({row.body for row in JOB_KINDS.values()}) == len(JOB_KINDS)


def test_a_job_whose_log_is_gone_stays_as_it_was(service):
    job = service.store.new_job("fit", FitIn(logs=["upload-00000000"]).model_dump())
    service.store.update(job, status="stopped", words="stopped")
    with pytest.raises(InputError, match="no such log"):
        service.resume(job)
    assert (service.store.job(job).status, service.submitted) == ("stopped", [])


def test_a_journey_has_no_worker_to_resume_it(service):
    job = service.store.new_job("journey", JourneyIn().model_dump())
    service.store.update(job, status="stopped")
    with pytest.raises(Refused, match="a job that is stopped cannot be resumed"):
        service.resume(job)
    assert service.submitted == []


def test_a_job_is_resumed_once(service, monkeypatch):
    job = service.submit(DriveIn(driver="flat_out"))
    service.store.update(job, status="interrupted")
    before = service.store.job(job)
    service.resume(job)
    monkeypatch.setattr(service.store, "job", lambda _: before)  # the other one looked before
    with pytest.raises(Refused, match="queued cannot be resumed"):
        service.resume(job)
    assert len(service.submitted) == 2


def test_a_campaign_knows_its_rows_whenever_its_worker_is_away(service, monkeypatch):
    def counts():
        row = evidence.campaign_list(service)[0]
        return row["rows"], row["done"]

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    matrix = {"drivers": ["flat_out", "manual"], "sections": ["yizhuang RJ WYJ"], "loads": ["AW2"]}
    values = {"name": "tiny", "matrix": {**matrix, "times": [1.2, 1.4]}}
    job = service.submit(CampaignIn.model_validate(values))
    assert counts() == (4, 0)
    campaign = campaign_from_values(Path("campaign"), values)
    store = CampaignStore(service.root / "jobs" / job / campaigns.FOLDER, campaign)
    store.keep(compute_shard(campaign.text, campaign.pieces()[0]))
    service.store.update(job, status="interrupted", words="the server was restarted; it can be resumed")
    assert counts() == (4, 1)
    service.resume(job)
    assert counts() == (4, 1)
    monkeypatch.setattr(campaigns, "run_campaign", interrupt)
    assert campaigns.campaign_job(str(service.root), job, values)["done"] == 1
    assert service.store.job(job).words == "1 of 4 rows"


def test_a_worker_that_starts_late_does_not_run_a_stopped_job(service):
    job = service.submit(DriveIn(driver="flat_out"))
    service.stop(job)
    JobStore(service.root).begin(job, "driving")
    assert service.store.job(job).status == "stopped"
    other = service.submit(DriveIn(driver="flat_out"))
    JobStore(service.root).begin(other, "driving")
    assert (service.store.job(other).status, service.store.job(other).words) == ("running", "driving")


def test_the_watch_of_live_runs_goes_on_after_an_error(service, monkeypatch, capsys):
    looks = []

    async def fail():
        looks.append(1)
        raise RuntimeError("disk full")

    async def watch():
        monkeypatch.setattr(services, "WATCH_S", 0.01)
        monkeypatch.setattr(service, "stop_abandoned", fail)
        task = asyncio.create_task(service._watch_live())
        await asyncio.sleep(0.2)
        task.cancel()

    asyncio.run(watch())
    assert len(looks) > 1
    assert "disk full" in capsys.readouterr().err


def test_a_convoy_has_the_control_period_of_the_command_line():
    assert ConvoyIn().dt_s == inspect.signature(convoy_command).parameters["dt_s"].default


@pytest.mark.parametrize("line", ["zurich-stadelhofen", "yizhuang"])
def test_a_line_has_no_more_zones_than_sections_where_the_request_leaves_it_open(service, line):
    sections = len(load_line(line).stations) - 1
    job = service.submit(OperationIn(line=line))
    assert service.store.job(job).request["zones"] == min(4, sections)
    with pytest.raises(InputError, match="zones"):
        service.submit(OperationIn(line=line, zones=sections + 1))


def test_a_random_trainset_is_no_upload(service):
    assert catalogue.trainset_out(service, "drawn-1-1")["uploaded"] is False


def test_a_history_that_is_being_written_is_shown(service, monkeypatch):
    run = service.root / "runs" / "ppo-1"
    run.mkdir(parents=True)
    (run / PROGRESS).write_text('{"steps": 1, "score": 2.0}\n{"steps": 2, "sco')
    monkeypatch.setattr(catalogue, "run_out", lambda *_: None)
    assert catalogue.history(service, "ppo-1") == {"steps": [1], "score": [2.0]}


def test_a_text_is_found_with_all_its_characters(service):
    job = service.store.new_job("drive", {"line": "yizhuang"})
    assert [row.id for row in service.store.jobs(text="YIZHUANG")] == [job]
    for text in ("\x00", "%", "_", "\\"):
        assert service.store.jobs(text=text) == []


def test_an_outcome_says_what_was_not_met():
    assert outcome_words("arrived", ["on time", "jerk"]) == "arrived: not on time, jerk"
    assert outcome_words("arrived", []) == "arrived"


@pytest.mark.parametrize(("error", "news"), [(asyncio.CancelledError(), False), (OSError("full"), True)])
def test_a_page_that_is_open_at_the_end_is_no_error_of_the_server(error, news):
    record = logging.LogRecord("uvicorn.error", logging.ERROR, "", 0, "", (), (type(error), error, None))
    assert is_news(record) is news
    assert is_news(logging.LogRecord("uvicorn.error", logging.INFO, "", 0, "", (), None))
    told = f"Traceback (most recent call last):\n  ...\nasyncio.exceptions.{type(error).__name__}\n"
    assert is_news(logging.LogRecord("uvicorn.error", logging.ERROR, "", 0, told, (), None)) is news
