"""Learned drivers as C or WebAssembly; JAX traces them, so that no bound on the address space can hold."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from metropilot.railway import Section, Trainset, load_line, load_trainset
from metropilot.web.errors import Refused
from metropilot.web.store import JobStore
from metropilot.web.work.drives import folder_of


@dataclass(frozen=True)
class ExportRequest:
    """A driver to write, its names resolved.

    Attributes:
        driver: Id of the driver.
        policy: File of its policy; None: the one that ships.
        line: Line.
        ends: Origin and destination; None: every section both ways.
        trainset: Trainset.
        load: Load aboard.
        to: ``c``, or ``wasm`` besides.
        number: Type of its numbers.
    """

    driver: str
    policy: str | None
    line: str
    ends: tuple[str, str] | None
    trainset: str
    load: str | None
    to: Literal["c", "wasm"]
    number: Literal["double", "float"]

    def read(self) -> tuple[list[Section], Trainset]:
        """Read and check what it names.

        Raises:
            MetropilotError: A name is unknown, the driver cannot be exported, or there is no compiler.
        """
        from metropilot.aboard import check_exportable, find_zig
        from metropilot.policy import shipped_policy

        line, trainset = load_line(self.line), load_trainset(self.trainset, self.load)
        if self.policy is None and not shipped_policy(self.driver).is_file():
            allowed = "a driver with a policy that ships, or learned:policy=ID"
            raise Refused("the driver has no policy", 422, field="driver", value=self.driver, allowed=allowed)
        check_exportable(self.driver)
        if self.to == "wasm":
            find_zig()
        if self.ends is None:
            return [*line.sections(), *line.sections(backward=True)], trainset
        return [line.section(*self.ends)], trainset


def export_job(root: str, job: str, request: ExportRequest) -> dict[str, Any]:
    """Write a driver as C, and as WebAssembly besides, into the job's folder."""
    store = JobStore(Path(root))
    store.begin(job, "tracing", 0.1)
    from metropilot.aboard import find_zig, trace_driver, write_driver
    from metropilot.policy import load_driving_policy, shipped_policy

    sections, trainset = request.read()
    driver = load_driving_policy(request.policy or shipped_policy(request.driver))
    program = trace_driver(request.driver, driver, sections, trainset, number=request.number)
    store.update(job, progress=0.7, words="writing")
    report = write_driver(
        program, folder_of(root, job), compiler=find_zig() if request.to == "wasm" else None
    )
    told = asdict(report)
    del told["folder"]
    return told
