"""Files beside the pages of the documentation: rows of campaigns and studies, pages and figures of studies.

The wheel holds them in the folder ``published``; a checkout has them in ``docs``.
"""

from __future__ import annotations

from pathlib import Path

from metropilot.errors import InputError

PACKAGE = Path(__file__).parent
FOLDERS = (PACKAGE / "published", PACKAGE.parents[1] / "docs")


def published_file(name: str) -> Path:
    """Path of a file beside a page.

    Args:
        name: Its path from the documentation's folder.

    Raises:
        InputError: It is not there.
    """
    for folder in FOLDERS:
        if (folder / name).exists():
            return folder / name
    raise InputError(
        "not published", field="file", value=name, allowed="a file of the wheel or of a checkout"
    )
