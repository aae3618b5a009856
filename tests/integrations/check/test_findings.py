import pytest

from deep_curiosity.integrations.check import Finding, Report

REPORT = Report(
    (
        Finding("raw", True, "all is well", "unneeded"),
        Finding("fresh", None, "not answered", "unneeded"),
    )
)
FAILED = Report((*REPORT.findings, Finding("state", False, "lost", "save it")))


def test_what_was_not_answered_does_not_fail():
    assert REPORT.passed and not FAILED.passed


def test_a_line_is_found_by_its_question():
    assert FAILED["state"].observed == "lost"
    with pytest.raises(KeyError):
        REPORT["state"]


def test_the_table_says_what_to_do_only_where_a_line_failed():
    assert str(FAILED).splitlines() == [
        "raw    yes  all is well",
        "fresh  -    not answered",
        "state  NO   lost",
        "            -> save it",
    ]
