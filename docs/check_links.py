"""Follows every local link and picture of the built site: `python docs/check_links.py site`."""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit


class Page(HTMLParser):
    """What a page links to, and the names in it that can be linked."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.names: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect."""
        for name, value in attrs:
            if name in ("href", "src") and value:
                self.links.append(value)
            if name in ("id", "name") and value:
                self.names.add(value)


def broken_links(site: Path) -> list[str]:
    """Links of the site that lead nowhere, each with its page; other sites are not asked."""
    pages = {path: Page(path.read_text()) for path in site.rglob("*.html")}
    broken = []
    for path, page in pages.items():
        for link in page.links:
            target, fragment = urlsplit(link).path, urlsplit(link).fragment
            if urlsplit(link).scheme:
                continue
            file = (path.parent / unquote(target)).resolve() if target else path.resolve()
            names = pages[file].names if file in pages else {fragment}
            if not file.exists() or (fragment and unquote(fragment) not in names):
                broken.append(f"{path.relative_to(site)}: {link}")
    return broken


if __name__ == "__main__":
    found = broken_links(Path(sys.argv[1]).resolve())
    print(*found, sep="\n")
    print(f"{len(found)} links lead nowhere")
    sys.exit(bool(found))
