"""`metropilot serve`."""

from __future__ import annotations

import signal
import socket
import sys
from pathlib import Path
from typing import Annotated

import typer

from metropilot.cli import options as opt
from metropilot.cli.console import console, print_json
from metropilot.errors import InputError

EXAMPLES = {
    "serve": (
        "metropilot serve",
        "metropilot serve --port 9000 --data console",
        "METROPILOT_TOKEN=$(openssl rand -hex 16) metropilot serve --host 0.0.0.0",
        "metropilot serve --users users.txt --public-host console.example",
    ),
}


def serve_command(
    host: Annotated[str, typer.Option(help="Address to listen on; any but loopback needs a token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.")] = 8060,
    data: Annotated[
        Path | None,
        typer.Option(metavar="FOLDER", help="Uploads, jobs and runs; a folder of the user's own."),
    ] = None,
    token: Annotated[
        str | None,
        typer.Option(envvar="METROPILOT_TOKEN", help="What a browser or program must present."),
    ] = None,
    users: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Users: a line NAME = TOKEN, ROLE each; roles user and viewer."),
    ] = None,
    user_header: Annotated[
        str | None,
        typer.Option(metavar="HEADER", help="Header in which a trusted proxy names the user."),
    ] = None,
    trusted_proxy: Annotated[
        list[str] | None,
        typer.Option(metavar="ADDRESS", help="Address of a proxy whose header counts; repeatable."),
    ] = None,
    public_host: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Name under which a proxy serves the console; repeatable."),
    ] = None,
    user_jobs: Annotated[int, typer.Option(min=1, help="Jobs that a named user may have under way.")] = 8,
    user_mb: Annotated[
        float,
        typer.Option("--user-mb", min=0.01, max=1e6, help="Runs and uploads that a named user may keep, MB."),
    ] = 2000.0,
    workers: Annotated[int, typer.Option(min=1, help="Drives and comparisons computed at once.")] = 1,
    upload_mb: Annotated[
        float, typer.Option("--upload-mb", min=0.01, max=1000.0, help="Largest upload, MB.")
    ] = 1.0,
    job_s: Annotated[
        float, typer.Option("--job-s", min=1.0, max=86_400.0, help="Longest drive or comparison, s.")
    ] = 600.0,
    as_json: opt.Json = False,
) -> int:
    """Open the web console and the HTTP API.

    Everything works without a network. The API is described at /api/openapi.json. Jobs and runs that a
    restart interrupts can be resumed.
    """
    try:
        from metropilot.web import Settings, data_folder, read_users, serve

        import_check()
    except ModuleNotFoundError as error:
        raise InputError(
            f"the web console is not installed ({error.name})", allowed="pip install 'metropilot[web]'"
        ) from None
    settings = Settings(
        data=data or data_folder(),
        host=host,
        port=port or free_port(host),
        token=token,
        users=() if users is None else read_users(users),
        user_header=user_header,
        trusted_proxies=tuple(trusted_proxy or ()),
        public_hosts=tuple(public_host or ()),
        user_jobs=user_jobs,
        user_bytes=int(user_mb * 1_000_000),
        parallel_jobs=workers,
        upload_bytes=int(upload_mb * 1_000_000),
        job_s=job_s,
    )
    check_free(settings.host, settings.port)
    from metropilot._io import check_writable

    try:
        check_writable(settings.data)
    except InputError as error:
        raise error.at(field="--data") from None
    query = "/?token=…" if settings.token or any(user.token for user in settings.users) else "/"
    shown = f"[{host}]" if ":" in host else host
    url = f"http://{shown}:{settings.port}"
    if as_json:
        print_json({"url": url, "openapi": f"{url}/api/openapi.json", "data": str(settings.data)})
    else:
        console().print(f"metropilot console: {url}{query}  (Ctrl-C ends it)")
    sys.stdout.flush()
    serve(settings)
    # the server has ended well; another Ctrl-C must not end the process by the signal on its last way
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    return 0


def import_check() -> None:
    """Check that the extra is installed."""
    import nicegui  # noqa: F401
    import pebble  # noqa: F401


def free_port(host: str) -> int:
    """Find a free port."""
    with socket.create_server((host, 0), family=_family(host)) as probe:
        return int(probe.getsockname()[1])


def check_free(host: str, port: int) -> None:
    """Check before the start of the server that it can listen.

    Raises:
        InputError: The address is in use or not available.
    """
    try:
        with socket.create_server((host, port), family=_family(host)):
            return
    except OSError as error:
        raise InputError(
            f"cannot listen ({error.strerror})", field="port", value=port, allowed="a free port"
        ) from None


def _family(host: str) -> socket.AddressFamily:
    return socket.AF_INET6 if ":" in host else socket.AF_INET
