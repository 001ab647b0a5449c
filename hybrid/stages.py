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


class Stopwatch:
    """Seconds spent in each stage."""

    def __init__(self) -> None:
        self._last = time.perf_counter()
        self._spent: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Adds the time since the last call to a stage."""
        now = time.perf_counter()
        self._spent[stage] = self._spent.get(stage, 0.0) + now - self._last
        self._last = now

    def __getitem__(self, stage: str) -> float:
        return self._spent.get(stage, 0.0)


__all__ = ["Clock", "Decision", "Report", "Stopwatch"]
