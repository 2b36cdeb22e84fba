"""Write docs/api.md: every public name of every package with the first line of its docstring.

The names come from each package's `__all__`; a test fails when the page and the doors differ.

    python tools/api_page.py
"""

import importlib
import inspect
import pkgutil
from pathlib import Path

import metropilot

PAGE = Path(__file__).resolve().parent.parent / "docs" / "api.md"
HEADER = """\
# Public names

What each package offers. Anything not listed here is private and may change without notice.
This page is written by `make api`; a test fails when it and the packages differ.
"""
# The order of the layers: a package may import only from those before it.
LAYERS = (
    "railway",
    "physics",
    "protection",
    "planning",
    "sim",
    "control",
    "env",
    "policy",
    "drivers",
    "learn",
    "evaluate",
    "campaign",
    "convoy",
    "fit",
    "operation",
    "aboard",
    "studies",
    "cli",
    "web",
)


def summary(value: object) -> str:
    """Return the first line of a name's own docstring, or what kind of value it is."""
    if inspect.isclass(value) or inspect.isroutine(value) or inspect.ismodule(value):
        text = inspect.getdoc(value) or ""
        return text.strip().partition("\n")[0]
    return f"A value of type `{type(value).__name__}`."


def section(name: str) -> str:
    """Return the part of the page about one package."""
    package = importlib.import_module(f"metropilot.{name}")
    rows = [f"- `{public}`: {summary(getattr(package, public))}" for public in sorted(package.__all__)]
    return "\n".join([f"\n## metropilot.{name}\n", summary(package), "", *rows]) + "\n"


def main() -> None:
    """Write the page for the packages that exist."""
    present = {module.name for module in pkgutil.iter_modules(metropilot.__path__) if module.ispkg}
    names = [name for name in LAYERS if name in present]
    PAGE.write_text(HEADER + "".join(section(name) for name in names))


if __name__ == "__main__":
    main()
