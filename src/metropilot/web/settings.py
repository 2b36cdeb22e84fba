"""Settings of a server: address, data folder and bounds."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from metropilot.errors import InputError

LOOPBACK = ("127.0.0.1", "localhost", "::1")
TOKEN_LENGTH = 16
"""Shortest token."""


def data_folder() -> Path:
    """``$XDG_DATA_HOME/metropilot``, or ``~/.local/share/metropilot``."""
    base = os.environ.get("XDG_DATA_HOME") or Path.home() / ".local" / "share"
    return Path(base) / "metropilot"


@dataclass(frozen=True)
class Settings:
    """Settings of a server.

    Attributes:
        data: Folder of uploads, jobs and learning runs; made if it is not there.
        host: Address to listen on.
        port: Port to listen on.
        token: Secret of every client; required where the host is not loopback.
        parallel_jobs: Drives and comparisons computed at once.
        queued_jobs: Jobs that may wait.
        live_runs: Live runs at once.
        upload_bytes: Largest upload.
        log_bytes: Largest upload of a log.
        archive_bytes: Largest archive of a project, packed or unpacked.
        request_bytes: Largest body of any other request.
        answer_s: Longest computation of a direct answer (a plan, a front, an upload).
        job_s: Longest drive or comparison.
        learn_s: Longest part of a learning job or campaign; it can be resumed.
        campaign_rows: Rows of a campaign at most.
        worker_bytes: Address space of a worker, except the learning one.
    """

    data: Path = field(default_factory=data_folder)
    host: str = "127.0.0.1"
    port: int = 8060
    token: str | None = None
    parallel_jobs: int = 1
    queued_jobs: int = 32
    live_runs: int = 4
    upload_bytes: int = 1_000_000
    log_bytes: int = 8_000_000
    archive_bytes: int = 64_000_000
    request_bytes: int = 100_000
    answer_s: float = 60.0
    job_s: float = 600.0
    learn_s: float = 12 * 3600.0
    campaign_rows: int = 20_000
    worker_bytes: int = 6 * 2**30

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise InputError("out of range", field="port", value=self.port, allowed="0 to 65535")
        if self.host not in LOOPBACK and not self.token:
            raise InputError(
                "other machines could use the console: give a token",
                field="token",
                allowed=f"--token or METROPILOT_TOKEN, at least {TOKEN_LENGTH} characters",
            )
        if self.token is not None and len(self.token) < TOKEN_LENGTH:
            raise InputError(
                "too short", field="token", value="*" * len(self.token), allowed=f"{TOKEN_LENGTH} characters"
            )

    @property
    def is_local(self) -> bool:
        """True where only this machine can reach the server."""
        return self.host in LOOPBACK
