"""TTOBench JSON, versions 1.1 to 1.5: which kind a file is.

Units are those the file names. What metropilot does not use is kept in ``extra``, written back by
:func:`metropilot.railway.formats.ttobench_write.export_ttobench`, and named in ``unused``.

Source: TTOBench v1.5, Kouzoupis et al. 2023, doi 10.1007/s43069-023-00248-x.
"""

from __future__ import annotations

from metropilot.errors import InputError
from metropilot.railway.formats.reader import Node
from metropilot.railway.formats.toml_common import located
from metropilot.railway.formats.ttobench_track import read_track, read_ttobench_journey
from metropilot.railway.formats.ttobench_train import read_train
from metropilot.railway.journey import Journey
from metropilot.railway.line import Line
from metropilot.railway.trainset import Trainset


def read_ttobench(root: Node, stem: str) -> Line | Trainset | Journey:
    """The track, train or journey that a TTOBench document describes.

    Args:
        root: The whole document.
        stem: The file's name without its ending: the id where the metadata has none.

    Raises:
        InputError: It is none of the three, or anything in it is missing, malformed or out of range.
    """
    try:
        if "timing points" in root:
            return read_ttobench_journey(root, stem)
        if "stops" in root or "speed limits" in root:
            return read_track(root, stem)
        if "mass" in root or any(key.startswith("max ") for key in root.data):
            return read_train(root, stem)
    except InputError as error:
        raise (error if error.file else located(error, root.file)) from error
    raise InputError(
        "neither a track, a train nor a journey of TTOBench",
        file=root.file,
        field="stops, mass, timing points",
        allowed="one of these three at the top",
    )
