import runpy

from tests.docs.pages import ROOT

check_links = runpy.run_path(str(ROOT / "docs" / "check_links.py"))


def test_links_that_lead_nowhere_are_found_and_others_are_not(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "page.html").write_text(
        '<a href="../index.html#here"><a href="../index.html#gone"><img src="no.png">'
        '<a href="https://example.org/nothing"><a href="#own"><p id="own">'
    )
    (tmp_path / "index.html").write_text('<h1 id="here"><a href="a/page.html"><a href="b.html">')
    assert sorted(check_links["broken_links"](tmp_path)) == [
        "a/page.html: ../index.html#gone",
        "a/page.html: no.png",
        "index.html: b.html",
    ]
