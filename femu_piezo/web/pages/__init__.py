"""The pages, one module each."""

from __future__ import annotations

from femu_piezo.web.pages import diagnosis, export, lot, modes, specimen, sweep, update
from femu_piezo.web.site import Site


def register(site: Site) -> None:
    """Give every page its address."""
    for page in (sweep, specimen, update, diagnosis, modes, lot, export):
        page.register(site)
