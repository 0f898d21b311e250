"""The interface of an impedance analyser: its identity, one sweep, its output off at the end.

An instrument gets only the commands of its driver's table, and no level, bias or frequency beyond the [limits] of the
specimen. An analyser is a context manager, which switches the output off at its end, after an error and after Ctrl-C.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import TracebackType
from typing import Any, ClassVar, Literal, Self

import numpy as np

from femu_piezo.errors import InputError, InstrumentError
from femu_piezo.measurement.segments import Segment, in_sweeps, segments
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.specimen.file import Limits

#: Most errors that are read out of the queue at once.
_LONGEST_QUEUE = 100
#: Difference allowed between a level read back and the level set, over the larger of limits.voltage and 1 V.
_LEVEL_RESOLUTION = 1e-3


@dataclass(frozen=True)
class Command:
    """A command of an instrument.

    Attributes
    ----------
    text : with {} for its arguments
    source : where it is documented
    seen : how it was checked: "text" (the words of the manual), "driver" (a published driver sends it), "" (not)
    """

    text: str
    source: str
    seen: Literal["text", "driver", ""]


@dataclass(frozen=True)
class Settings:
    """How an analyser measures.

    Attributes
    ----------
    voltage : V rms;  bias : V DC, switched off where 0
    speed : 1 (fast) to 5 (quiet), the bandwidth of the instrument
    averages : of each point
    timeout : seconds for a reply, in addition to the duration of a sweep
    """

    voltage: float = Limits().voltage
    bias: float = 0.0
    speed: int = 5
    averages: int = 1
    timeout: float = 10.0


def usual_drive(limits: Limits) -> float:
    """The drive where none is asked for, V rms: that of default [limits], or less where the given ones allow less."""
    return min(Settings.voltage, limits.voltage)


class Analyser(ABC):
    """A connected impedance analyser.

    Subclasses hold the table of commands and the order in which they are sent.

    Attributes
    ----------
    identity : what it answers to *IDN?;  compensation : state of its fixture compensation, in words
    """

    model: ClassVar[str]
    commands: ClassVar[Mapping[str, Command]]
    #: Capabilities: Hz, V rms, V of bias, segments and points of one sweep, seconds of a point at each speed.
    band_Hz: ClassVar[tuple[float, float]]
    voltages: ClassVar[tuple[float, float]]
    most_bias: ClassVar[float]
    most_segments: ClassVar[int]
    most_points: ClassVar[int]
    seconds: ClassVar[tuple[float, ...]]
    #: Commands that choose what is measured, and the traces that hold R and X.
    setup: ClassVar[tuple[str, ...]]
    traces: ClassVar[tuple[object, object]]

    def __init__(self, session: Session, limits: Limits, settings: Settings) -> None:
        self._session, self.limits, self.settings = session, limits, settings
        self.identity = session.identity
        self.compensation = ""
        self._refuse(settings)

    def __enter__(self) -> Self:
        try:
            self._prepare()
            self._check("its settings")
        except BaseException as error:
            self.__exit__(type(error), error, None)
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is not None:  # part of a reply may still arrive
                self._session.reconnect()
            self._off()
            if kind is None:
                self._check("the end")
        except InstrumentError as failure:
            words = f"the output of the {self.model} may still be on, switch it off at the instrument: {failure}"
            raise InstrumentError(f"{error}; {words}" if isinstance(error, InstrumentError) else words) from error
        finally:
            self._session.close()

    def sweep(self, frequency: np.ndarray, voltage: float | None = None, *, rising: bool = True) -> ImpedanceSpectrum:
        """Z at frequencies (n,), Hz, and at a few more where segments need them.

        Parameters
        ----------
        voltage : V rms; that of the settings where None
        rising : whether the frequency rises in time

        Raises
        ------
        InputError : a frequency or a voltage is outside [limits] or the ranges of the instrument
        InstrumentError : it does not answer, reports an error, or marks points as not measured
        """
        voltage = self.settings.voltage if voltage is None else voltage
        self._refuse_voltage(voltage)
        wanted = segments(frequency)
        self._refuse_band(min(one.start for one in wanted), max(one.stop for one in wanted))
        parts: list[tuple[np.ndarray, np.ndarray]] = []
        sweeps = list(in_sweeps(wanted, self.most_segments, self.most_points))
        for one in sweeps if rising else sweeps[::-1]:
            points = sum(segment.points for segment in one)
            self._arrange(one, voltage, rising)
            self._check("the list of frequencies")
            self._trigger()
            self._session.wait(
                self.commands["wait"].text, self.settings.timeout + points * self._seconds_of_point(one[0].start)
            )
            self._check("the sweep")
            parts.append(self._read(points))
        frequencies, place = np.unique(np.concatenate([f for f, _ in parts]), return_index=True)
        z = np.concatenate([z for _, z in parts])[place]
        return ImpedanceSpectrum(frequencies, z, source=self.model)

    def _seconds_of_point(self, frequency: float) -> float:
        """An upper bound: measurement time and ten periods, twice as long for range changes of auto ranging."""
        return 2 * self.settings.averages * (self.seconds[self.settings.speed - 1] + 10 / frequency)

    def _refuse(self, settings: Settings) -> None:
        self._refuse_voltage(settings.voltage)
        allowed = min(self.limits.bias, self.most_bias)
        if abs(settings.bias) > allowed:
            raise InputError(
                f"a bias of {settings.bias:g} V is above the {allowed:g} V that limits.bias and the analyser allow"
            )

    def _refuse_voltage(self, voltage: float) -> None:
        if voltage > self.limits.voltage:
            raise InputError(
                f"a drive of {voltage:g} V is above limits.voltage = {self.limits.voltage:g} V of the specimen file"
            )
        low, high = self.voltages
        if not low <= voltage <= high:
            raise InputError(f"a drive of {voltage:g} V is outside the {low:g} … {high:g} V of the {self.model}")

    def _refuse_band(self, low: float, high: float) -> None:
        of_model = (f"the range of the {self.model}", self.band_Hz)
        for whose, (lowest, highest) in (("limits.frequency", self.limits.frequency or self.band_Hz), of_model):
            if low < lowest or high > highest:
                raise InputError(f"{low:g} … {high:g} Hz are outside {lowest:g} … {highest:g} Hz, {whose}")

    def _send(self, name: str, *arguments: object) -> None:
        self._session.write(self.commands[name].text.format(*arguments))

    def _ask(self, name: str) -> str:
        return self._session.query(self.commands[name].text)

    def _numbers(self, name: str, count: int) -> np.ndarray:
        """The (count,) numbers of a reply; InstrumentError where these are more or fewer, or marked as not measured."""
        words = self._ask(name).split(",")
        if len(words) != count:
            raise InstrumentError(f"the {self.model} sent {len(words)} of {count} numbers; {ONWARDS}")
        values = np.array([_number(word) for word in words])
        if not np.all(np.isfinite(values)):
            bad = int(np.sum(~np.isfinite(values)))
            raise InstrumentError(
                f"the {self.model} marks {bad} of {count} values as not measured (overload): check the contacts, or "
                "lower --voltage; " + ONWARDS
            )
        return values

    def _check(self, step: str) -> None:
        """Read the error queue; InstrumentError where it holds errors."""
        errors = []
        for _ in range(_LONGEST_QUEUE):
            reply = self._ask("error")
            code = reply.split(",")[0].strip()
            if not code.lstrip("+-").isdigit():
                raise InstrumentError(f"the {self.model} answers {reply[:60]!r} when asked for errors; {ONWARDS}")
            if int(code) == 0:
                break
            errors.append(reply.strip())
        if errors:
            raise InstrumentError(f"the {self.model} reports {'; '.join(errors)} after {step}; {ONWARDS}")

    def _confirm(self, asked: float, reply: str) -> None:
        """Raise InstrumentError where the level read back is not the level set, V."""
        if not abs(_number(reply) - asked) <= _LEVEL_RESOLUTION * max(1.0, self.limits.voltage):
            raise InstrumentError(f"the {self.model} gives {reply.strip()} V where {asked:g} V were set; {ONWARDS}")

    def _prepare(self) -> None:
        """Set everything except level, bias and frequencies; read the state of the compensation."""
        self._send("clear")
        self._off()
        for name in self.setup:
            self._send(name)
        self._send("speed", self.settings.speed)
        self._send("averages", self.settings.averages)
        self._send("averaging", "ON" if self.settings.averages > 1 else "OFF")
        states = {name: self._ask(name).strip() in ("1", "+1", "ON") for name in ("open", "short", "load")}
        self.compensation = ", ".join(f"{name} {'on' if state else 'off'}" for name, state in states.items())

    def _arrange(self, listed: Sequence[Segment], voltage: float, rising: bool) -> None:
        """Set level, list of frequencies, direction and bias of one sweep."""
        self._send("level", voltage)
        self._confirm(voltage, self._ask("level_is"))
        self._list(listed)
        self._send("direction", "UP" if rising else "DOWN")
        if self.settings.bias:
            self._send("bias_mode")
            self._send("bias_level", self.settings.bias)
            self._send("bias", "ON")

    def _read(self, points: int) -> tuple[np.ndarray, np.ndarray]:
        """Frequencies (points,), Hz, and Z (points,), ohm, of the sweep that has ended."""
        frequency = self._numbers("frequencies", points)
        parts = []
        for trace in self.traces:
            self._send("select", trace)
            parts.append(
                self._numbers("values", 2 * points)[::2]
            )  # pairs: the value, and a second number that only complex formats use
        return frequency, parts[0] + 1j * parts[1]

    def _off(self) -> None:
        """Stop measuring, bias off, level to the lowest: these analysers have no switch for their output."""
        self._stop()
        self._send("bias", "OFF")
        self._send("level", self.voltages[0])
        self._ask("wait")

    @abstractmethod
    def _list(self, listed: Sequence[Segment]) -> None:
        """Set the segments of the next sweep."""

    @abstractmethod
    def _trigger(self) -> None:
        """Start one sweep."""

    @abstractmethod
    def _stop(self) -> None:
        """Break off the sweep, and begin no other."""


#: End of the message of a fault: how to go on.
ONWARDS = "no point is lost, and the same command goes on from there"


def _number(word: str) -> float:
    """A number of a reply; nan for the marks of values that were not measured (1.#QNB, 9.9E+37)."""
    try:
        value = float(word)
    except ValueError:
        return np.nan
    return value if abs(value) < 9e36 else np.nan


@cache
def _resources() -> Any:
    """The `pyvisa.ResourceManager` of this process: its search for a library runs the compiler five times."""
    import pyvisa

    return pyvisa.ResourceManager()


class Session:
    """A VISA connection, whose errors are InstrumentError with one sentence.

    Parameters
    ----------
    address : VISA resource, such as TCPIP::127.0.0.1::5025::SOCKET, USB0::…::INSTR or GPIB0::17::INSTR
    timeout : seconds for a reply
    """

    def __init__(self, address: str, timeout: float) -> None:
        try:
            import pyvisa
        except ImportError:
            raise InputError("an analyser needs further packages; pip install 'femu-piezo[measure]'") from None
        self._visa, self.address, self._timeout = pyvisa, address, timeout
        self._resource: Any = None
        self._open()
        try:
            self.identity = self.query("*IDN?").strip()
        except InstrumentError:
            self.close()
            raise self._unreachable("no answer to *IDN?") from None

    def _open(self) -> None:
        try:
            self._resource = _resources().open_resource(
                self.address, read_termination="\n", write_termination="\n", timeout=1000 * self._timeout
            )
        except Exception as error:  # pyvisa-py raises bare exceptions for a host or a port that there is not
            is_address = "::" in self.address
            why = _words(error) if is_address else "a VISA address is such as TCPIP::192.168.0.7::5025::SOCKET"
            raise self._unreachable(why) from None

    def _unreachable(self, why: str) -> InstrumentError:
        return InstrumentError(
            f"{self.address} cannot be reached ({why}); is the address right, the instrument on, and no other program "
            "connected?"
        )

    def reconnect(self) -> None:
        """Close and open the connection, so that no reply to an earlier question is taken for a later one."""
        self.close()
        self._open()

    def close(self) -> None:
        """Close the connection, broken or not."""
        try:
            self._resource.close()
        except (self._visa.Error, OSError):
            return

    def write(self, text: str) -> None:
        """Send a command."""
        self._guarded(text, lambda: self._resource.write(text))

    def query(self, text: str) -> str:
        """The reply to a question."""
        return self._guarded(text, lambda: self._resource.query(text))

    def wait(self, text: str, seconds: float) -> str:
        """The reply to a question, which may take so many seconds."""
        self._resource.timeout = 1000 * seconds
        try:
            return self.query(text)
        finally:
            self._resource.timeout = 1000 * self._timeout

    def _guarded(self, text: str, work):
        try:
            return work()
        except self._visa.VisaIOError as error:
            if error.error_code == self._visa.constants.StatusCode.error_timeout:
                seconds = self._resource.timeout / 1000
                raise InstrumentError(
                    f"{self.address} gave no whole answer to {text!r} within {seconds:.3g} s; {ONWARDS}"
                ) from None
            raise InstrumentError(f"the connection to {self.address} broke ({_words(error)}); {ONWARDS}") from None
        except (OSError, UnicodeDecodeError) as error:
            raise InstrumentError(f"the connection to {self.address} broke ({_words(error)}); {ONWARDS}") from None


def _words(error: Exception) -> str:
    return " ".join(str(error).split()).rstrip(".") or type(error).__name__
