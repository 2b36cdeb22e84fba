"""The command line: argument parsing and pages only."""

from metropilot.cli.app import main

__all__ = ["main"]
