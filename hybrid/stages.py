"""The reports of the stages that a photo goes through: what each did and why, and its seconds."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from hybrid.records import StageReport


@dataclass(frozen=True)
class Decision:
    """Whether something holds, with the one-line evidence for it."""

    yes: bool
    reason: str


@dataclass
class Report:
    """What a stage says of itself while it runs."""

    reason: str = ""
    ran: bool = True


class Clock:
    """Collects the reports of the stages of one photo, with their seconds."""

    def __init__(self) -> None:
        self.reports: tuple[StageReport, ...] = ()

    @contextmanager
    def stage(self, name: str) -> Iterator[Report]:
        report, start = Report(), time.perf_counter()
        yield report
        self.reports += (StageReport(name, report.ran, report.reason, time.perf_counter() - start),)

    def counts(self, reports: Sequence[StageReport]) -> None:
        """Put these reports in place of those of stages that ran several times. Seconds stay those of the first run;
        the others are part of the stages that called for them."""
        said = {report.name: report for report in reports}
        self.reports = tuple(
            replace(said[report.name], seconds=report.seconds) if report.name in said else report
            for report in self.reports
        )


__all__ = ["Clock", "Decision", "Report"]
