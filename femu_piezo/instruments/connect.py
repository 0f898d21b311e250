"""The driver of an instrument, chosen by its answer to *IDN?."""

from __future__ import annotations

from femu_piezo.errors import InputError
from femu_piezo.instruments.analyser import Analyser, Session, Settings
from femu_piezo.instruments.e4990a import E4990A
from femu_piezo.instruments.hp4294a import HP4294A
from femu_piezo.specimen.file import Limits

#: Analysers that are known.
DRIVERS: tuple[type[Analyser], ...] = (E4990A, HP4294A)


def connect(address: str, limits: Limits, settings: Settings) -> Analyser:
    """The analyser at a VISA address, to be used as a context manager.

    Raises
    ------
    InputError : settings above the limits, or no analyser that is known
    InstrumentError : nothing answers at the address
    """
    session = Session(address, settings.timeout)
    fields = [field.strip() for field in session.identity.split(",")]
    driver = next((one for one in DRIVERS if len(fields) > 1 and one.model in fields[1]), None)
    try:
        if driver is None:
            known = " and ".join(one.model for one in DRIVERS)
            raise InputError(
                f"{address} is {session.identity[:80]!r}, for which there is no driver; use one of {known}"
            )
        return driver(session, limits, settings)
    except InputError:
        session.close()
        raise
