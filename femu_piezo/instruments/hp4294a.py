"""HP/Agilent 4294A (its own mnemonics; GPIB, or a gateway to it)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from femu_piezo.instruments.analyser import Analyser, Command
from femu_piezo.measurement.segments import Segment

_MANUAL = "4294A Programming Manual 04294-90061, GPIB Command Reference, "


class HP4294A(Analyser):
    """HP/Agilent 4294A, 40 Hz to 110 MHz, list sweeps."""

    model = "4294A"
    band_Hz = (40.0, 110e6)
    voltages = (5e-3, 1.0)
    most_bias = 40.0
    most_segments, most_points = 18, 801
    seconds = (0.005, 0.01, 0.05, 0.2, 0.5)
    setup = ("trigger_source", "ascii", "parameters", "mode", "of_frequency")
    traces = ("A", "B")
    #: The commands of the list editor are those of the sister instrument 4395A, to which published drivers send them.
    commands: ClassVar[Mapping[str, Command]] = {
        "identify": Command("*IDN?", "IEEE 488.2, 10.14", "driver"),
        "clear": Command("*CLS", "IEEE 488.2, 10.3", "driver"),
        "wait": Command("*OPC?", "IEEE 488.2, 10.19", "driver"),
        "error": Command("OUTPERRO?", _MANUAL + "OUTPERRO?", "text"),
        "hold": Command("HOLD", _MANUAL + "HOLD", "driver"),
        "trigger_source": Command("TRGS INT", _MANUAL + "TRGS", "driver"),
        "trigger": Command("SING", _MANUAL + "SING", "driver"),
        "ascii": Command("FORM4", _MANUAL + "FORM4", "text"),
        "parameters": Command("MEAS IRIM", _MANUAL + "MEAS", "driver"),
        "select": Command("TRAC {}", _MANUAL + "TRAC", "driver"),
        "values": Command("OUTPDTRC?", _MANUAL + "OUTPDTRC?", "text"),
        "frequencies": Command("OUTPSWPRM?", _MANUAL + "OUTPSWPRM?", "driver"),
        "mode": Command("POWMOD VOLT", _MANUAL + "POWMOD", "driver"),
        "level": Command("POWE {:.4g}V", _MANUAL + "POWE", "driver"),
        "level_is": Command("POWE?", _MANUAL + "POWE", ""),
        "bias": Command("DCO {}", _MANUAL + "DCO", "driver"),
        "bias_mode": Command("DCMOD CVOLT", _MANUAL + "DCMOD", "driver"),
        "bias_level": Command("DCV {:.4g}", _MANUAL + "DCV", "driver"),
        "speed": Command("BWFACT {}", _MANUAL + "BWFACT", "driver"),
        "averages": Command("PAVERFACT {}", _MANUAL + "PAVERFACT", "driver"),
        "averaging": Command("PAVER {}", _MANUAL + "PAVER", "driver"),
        "of_frequency": Command("SWPP FREQ", _MANUAL + "SWPP", "driver"),
        "listed": Command("SWPT LIST", _MANUAL + "SWPT", "driver"),
        "direction": Command("SWED {}", _MANUAL + "SWED", "driver"),
        "edit": Command("EDITLIST", _MANUAL + "EDITLIST", ""),
        "empty": Command("CLEL", _MANUAL + "CLEL", ""),
        "add": Command("SADD", _MANUAL + "SADD", ""),
        "start": Command("STAR {:.3f}", _MANUAL + "STAR", "driver"),
        "stop": Command("STOP {:.3f}", _MANUAL + "STOP", "driver"),
        "points": Command("POIN {}", _MANUAL + "POIN", "driver"),
        "added": Command("SDON", _MANUAL + "SDON", ""),
        "edited": Command("EDITDONE", _MANUAL + "EDITDONE", ""),
        "open": Command("COMOPEN?", _MANUAL + "COMOPEN", ""),
        "short": Command("COMSHOR?", _MANUAL + "COMSHOR", ""),
        "load": Command("COMLOAD?", _MANUAL + "COMLOAD", ""),
    }

    def _list(self, listed: Sequence[Segment]) -> None:
        self._send("edit")
        self._send("empty")
        for one in listed:
            self._send("add")
            self._send("start", one.start)
            self._send("stop", one.stop)
            self._send("points", one.points)
            self._send("added")
        self._send("edited")
        self._send("listed")

    def _trigger(self) -> None:
        self._send("trigger")

    def _stop(self) -> None:
        self._send("hold")
