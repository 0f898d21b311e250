"""Check a built site: python docs/check_site.py docs/_build/html

Every internal link leads to a file and an anchor that are there, and no page loads anything over the network.
"""

from __future__ import annotations

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Attributes by which a page loads something, and by which it leads somewhere.
_LOADS = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src"), ("source", "src"), ("object", "data")}
_LEADS = {("a", "href")}


class _Page(HTMLParser):
    """The references of a page and what may be referred to in it."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.loads: list[str] = []
        self.leads: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {key: value for key, value in attrs if value is not None}
        self.anchors |= {given[key] for key in ("id", "name") if key in given}
        for key, value in given.items():
            if (tag, key) in _LOADS and given.get("rel") not in ("canonical", "index", "search", "next", "prev"):
                self.loads.append(value)
            if (tag, key) in _LEADS:
                self.leads.append(value)


def faults(site: Path) -> list[str]:
    """One sentence for each reference that is broken, or that needs the network to show the page."""
    paths = [path for path in sorted(site.rglob("*.html")) if "_static" not in path.parts]  # templates of the theme
    pages = {path: _Page(path.read_text(encoding="utf-8")) for path in paths}
    found = [] if pages else [f"{site}: there is no page"]
    for path, page in pages.items():
        for reference in [*page.loads, *page.leads]:
            parts = urlsplit(reference)
            if parts.scheme or parts.netloc:
                if reference in page.loads and parts.scheme != "data":
                    found.append(f"{path.relative_to(site)}: loads {reference}")
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path.resolve()
            if not target.is_file():
                found.append(f"{path.relative_to(site)}: {reference} leads to no file")
            elif parts.fragment and target.suffix == ".html":
                anchors = next((one.anchors for name, one in pages.items() if name.resolve() == target), set())
                if unquote(parts.fragment) not in anchors:
                    found.append(f"{path.relative_to(site)}: {reference} leads to no anchor")
    return found


def main(site: Path) -> int:
    """Print the faults; 1 where there are any."""
    found = faults(site)
    count = len(list(site.rglob("*.html")))
    print("\n".join(found) or f"{count} pages: no broken link, nothing loaded over the network")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
