"""Keysight E4990A (SCPI; LAN socket 5025, VXI-11, USB, GPIB)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar

from femu_piezo.instruments.analyser import Analyser, Command
from femu_piezo.measurement.segments import E4990A_MOST, Segment, segment_data

_HELP = "E4990A help, Programming, Command Reference, "
_EXAMPLE = "E4990A help, Programming, Sample Programs, measurement setup"


class E4990A(Analyser):
    """Keysight E4990A, 20 Hz to 120 MHz (as its option allows), segment sweeps."""

    model = "E4990A"
    band_Hz = (20.0, 120e6)
    voltages = (5e-3, 1.0)
    most_bias = 40.0
    most_segments, most_points = E4990A_MOST
    seconds = (0.005, 0.01, 0.05, 0.2, 0.5)
    setup = ("trigger_source", "ascii", "resistance", "reactance", "mode", "segmented")
    traces = (1, 2)
    #: Drivers were seen to set a falling direction for linear sweeps, not for segments; the frequencies that are read
    #: back belong to the values in either case.
    commands: ClassVar[Mapping[str, Command]] = {
        "identify": Command("*IDN?", "IEEE 488.2, 10.14", "driver"),
        "clear": Command("*CLS", "IEEE 488.2, 10.3", "driver"),
        "wait": Command("*OPC?", "IEEE 488.2, 10.19", "driver"),
        "error": Command(":SYST:ERR?", "SCPI-1999, 21.8", "driver"),
        "abort": Command(":ABOR", _HELP + ":ABORt", "text"),
        "initiate": Command(":INIT1:CONT {}", _HELP + ":INITiate<Ch>:CONTinuous", "text"),
        "trigger_source": Command(":TRIG:SOUR BUS", _HELP + ":TRIGger[:SEQuence]:SOURce", "text"),
        "trigger": Command(":TRIG:SING", _HELP + ":TRIGger[:SEQuence]:SINGle", "driver"),
        "ascii": Command(":FORM:DATA ASC", _HELP + ":FORMat:DATA", "driver"),
        "resistance": Command(":CALC1:PAR1:DEF R", _HELP + ":CALCulate<Ch>:PARameter<Tr>:DEFine", "text"),
        "reactance": Command(":CALC1:PAR2:DEF X", _HELP + ":CALCulate<Ch>:PARameter<Tr>:DEFine", "text"),
        "select": Command(":CALC1:PAR{}:SEL", _HELP + ":CALCulate<Ch>:PARameter<Tr>:SELect", "driver"),
        "values": Command(":CALC1:DATA:FDAT?", _HELP + ":CALCulate<Ch>[:SELected]:DATA:FDATa", "text"),
        "frequencies": Command(":SENS1:FREQ:DATA?", _HELP + ":SENSe<Ch>:FREQuency:DATA", "text"),
        "mode": Command(":SOUR1:MODE VOLT", _EXAMPLE, "driver"),
        "level": Command(":SOUR1:VOLT {:.4g}", _EXAMPLE, "driver"),
        "level_is": Command(":SOUR1:VOLT?", "query of the command above", ""),
        "bias": Command(":SOUR:BIAS:STAT {}", _HELP + ":SOURce:BIAS:STATe", "driver"),
        "bias_mode": Command(":SOUR1:BIAS:MODE VOLT", _HELP + ":SOURce<Ch>:BIAS:MODE", "driver"),
        "bias_level": Command(":SOUR1:BIAS:VOLT {:.4g}", _HELP + ":SOURce<Ch>:BIAS:VOLTage", "driver"),
        "speed": Command(":SENS1:APER:TIME {}", _HELP + ":SENSe<Ch>:APERture:TIME", "driver"),
        "averages": Command(":SENS1:AVER:COUN {}", _HELP + ":SENSe<Ch>:AVERage:COUNt", "driver"),
        "averaging": Command(":SENS1:AVER:STAT {}", _HELP + ":SENSe<Ch>:AVERage:STATe", "driver"),
        "segmented": Command(":SENS1:SWE:TYPE SEGM", _EXAMPLE, "driver"),
        "direction": Command(":SENS1:SWE:DIR {}", _HELP + ":SENSe<Ch>:SWEep:DIRection", "driver"),
        "segments": Command(":SENS1:SEGM:DATA {}", _HELP + ":SENSe<Ch>:SEGMent:DATA", "text"),
        "open": Command(":SENS1:CORR2:OPEN?", _HELP + ":SENSe<Ch>:CORRection2:OPEN", "driver"),
        "short": Command(":SENS1:CORR2:SHOR?", _HELP + ":SENSe<Ch>:CORRection2:SHORt", "driver"),
        "load": Command(":SENS1:CORR2:LOAD?", _HELP + ":SENSe<Ch>:CORRection2:LOAD", "driver"),
    }

    def _list(self, listed: Sequence[Segment]) -> None:
        self._send("segments", segment_data(listed))

    def _trigger(self) -> None:
        self._send("initiate", "ON")
        self._send("trigger")

    def _stop(self) -> None:
        self._send("initiate", "OFF")
        self._send("abort")
