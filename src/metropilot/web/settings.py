"""Settings of a server: address, data folder and bounds."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, field
from ipaddress import ip_address, ip_network
from pathlib import Path

from metropilot.errors import InputError
from metropilot.web.users import TOKEN_LENGTH, User

LOOPBACK = ("127.0.0.1", "localhost", "::1")
HEADER = re.compile(r"[A-Za-z][A-Za-z0-9-]{0,63}")
TAKEN_HEADERS = ("authorization", "cookie", "host", "origin")
"""Headers that have a meaning of their own."""


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
        token: Secret of every client; beyond loopback it, ``users`` or ``user_header`` is needed.
        users: Users by token, and roles of those that a proxy names.
        user_header: Header in which a trusted proxy names the user.
        trusted_proxies: Addresses or networks of the proxies whose header counts.
        public_hosts: Names under which a proxy serves the console.
        user_jobs: Jobs and live runs of a named user that may wait or run.
        user_bytes: Runs and uploads that a named user may keep.
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
    users: tuple[User, ...] = ()
    user_header: str | None = None
    trusted_proxies: tuple[str, ...] = ()
    public_hosts: tuple[str, ...] = ()
    user_jobs: int = 8
    user_bytes: int = 2_000_000_000
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
        if self.host not in LOOPBACK and not (self.token or self.users or self.user_header):
            raise InputError(
                "other machines could use the console: give a token",
                field="token",
                allowed=f"--token or METROPILOT_TOKEN, at least {TOKEN_LENGTH} characters, or --users",
            )
        if self.token is not None and len(self.token) < TOKEN_LENGTH:
            raise InputError(
                "too short", field="token", value="*" * len(self.token), allowed=f"{TOKEN_LENGTH} characters"
            )

        self._check_proxies()

    def _check_proxies(self) -> None:
        for address in self.trusted_proxies:
            try:
                ip_network(address, strict=False)
            except ValueError:
                told = {"value": address, "allowed": "an address such as 127.0.0.1, or a network"}
                raise InputError("not an address", field="trusted_proxy", **told) from None
        if self.user_header is None:
            return
        if not HEADER.fullmatch(self.user_header) or self.user_header.lower() in TAKEN_HEADERS:
            told = {"value": self.user_header[:80], "allowed": "a name such as X-Remote-User"}
            raise InputError("not a header for a name", field="user_header", **told)
        if not self.trusted_proxies:
            words = "anybody could send this header: name the proxy that sets it"
            raise InputError(words, field="trusted_proxy", allowed="--trusted-proxy ADDRESS")

    def trusts(self, address: str | None) -> bool:
        """Tell whether requests from an address are those of a trusted proxy."""
        try:
            found = ip_address(address or "")
        except ValueError:
            return False
        return any(found in ip_network(each, strict=False) for each in self.trusted_proxies)

    @property
    def names_users(self) -> bool:
        """True where users have names."""
        return bool(self.users or self.user_header)

    @property
    def is_local(self) -> bool:
        """True where only this machine can reach the server."""
        return self.host in LOOPBACK
