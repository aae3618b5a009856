"""What a check found, line by line, and what to do about it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One line of a report."""

    question: str
    passed: bool | None
    """`None` where it could not be answered."""
    observed: str
    advice: str
    """What to do where it failed."""


@dataclass(frozen=True)
class Report:
    """What the check found, line by line; printed as a table."""

    findings: tuple[Finding, ...]

    @property
    def passed(self) -> bool:
        """Whether no line failed."""
        return all(finding.passed is not False for finding in self.findings)

    def __getitem__(self, question: str) -> Finding:
        """Line of a question, such as `"fresh"`.

        Raises:
            KeyError: If the check has no such question.
        """
        for finding in self.findings:
            if finding.question == question:
                return finding
        raise KeyError(question)

    def __str__(self) -> str:
        """Table with what to do under each line that failed."""
        word = {True: "yes", False: "NO", None: "-"}
        width = max(len(finding.question) for finding in self.findings)
        lines = []
        for finding in self.findings:
            lines.append(
                f"{finding.question:{width}}  {word[finding.passed]:3}  {finding.observed}"
            )
            if finding.passed is False:
                lines.append(f"{'':{width}}       -> {finding.advice}")
        return "\n".join(lines)
