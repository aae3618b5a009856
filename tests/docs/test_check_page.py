from tests.docs.pages import ROOT, run_blocks

PAGE = ROOT / "docs/integrations/check.md"


def test_the_page_runs_as_written_and_lists_every_line_of_the_report():
    report = run_blocks(PAGE)["report"]
    assert report.passed
    for finding in report.findings:
        assert f"| `{finding.question}` |" in PAGE.read_text()
