"""Result of a functional check: figures, each with its limits."""

from dataclasses import dataclass, field

from telepresence.haptics.device.script import Script


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured quantity with its limits; None means no limit on that side.

    value: None if it could not be measured. That counts as failed if there is a limit.
    """

    name: str
    value: float | None
    unit: str = ""
    least: float | None = None
    most: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the value is within its limits."""
        if self.value is None:
            return self.least is None and self.most is None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of one functional check.

    trouble: one line that says why the check ended early; "" if it was completed.
    skipped: one line that says what the device lacks. A skipped check neither passed nor failed.
    """

    name: str
    figures: tuple[Figure, ...] = field(default=())
    trouble: str = ""
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """Whether every figure is within its limits and there was no trouble."""
        return not self.skipped and not self.trouble and all(f.passed for f in self.figures)

    @property
    def failed(self) -> bool:
        """Whether the check was done and did not pass."""
        return not self.skipped and not self.passed


CheckScript = Script[CheckResult]
