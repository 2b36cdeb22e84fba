"""The pages of the console."""

from __future__ import annotations

from fastapi import FastAPI

from metropilot.web.service import Service


def install(app: FastAPI, service: Service) -> None:
    """Add the pages to an application."""
