"""Frequencies for an analyser that sweeps segments: start, stop and a number of equally spaced points each."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

#: Resolution of the frequencies of impedance analysers, Hz (E4990A and 4294A: 1 mHz).
RESOLUTION = 1e-3
#: Segments and points that a Keysight E4990A takes in one sweep (its help: 1 to 201 segments, 2 to 1601 points).
E4990A_MOST = (201, 1601)
#: Relative distance of the second point that is added below a frequency where the sweep has only this one.
_COMPANION = 1e-4


@dataclass(frozen=True)
class Segment:
    """Equally spaced points from `start` to `stop`, Hz, both included; at least two."""

    start: float
    stop: float
    points: int

    @property
    def frequency(self) -> np.ndarray:
        """(points,) Hz."""
        return np.linspace(self.start, self.stop, self.points)


def segments(frequency: np.ndarray) -> list[Segment]:
    """A few segments that hold all of the frequencies (n,), Hz, to the resolution of analysers.

    A run of equal steps is one segment; other frequencies are taken in pairs. Since a segment has at least two points,
    a last single frequency is measured together with the middle between it and the one below.
    """
    f = np.unique(np.round(np.asarray(frequency, dtype=float) / RESOLUTION)) * RESOLUTION
    found, place = [], 0
    while place < f.size:
        length = max(_run(f[place:]), min(2, f.size - place))
        if length == 1:
            below = (f[place - 1] + f[place]) / 2 if place else f[place] * (1 - _COMPANION)
            found.append(Segment(float(np.round(below / RESOLUTION) * RESOLUTION), float(f[place]), 2))
        else:
            found.append(Segment(float(f[place]), float(f[place + length - 1]), length))
        place += length
    return found


def _run(f: np.ndarray) -> int:
    """Number of frequencies, from the first on, with equal steps to the resolution; 0 where fewer than three."""
    if f.size < 3:
        return 0
    even = f[0] + (f[1] - f[0]) * np.arange(f.size)
    count = int(np.argmin(np.append(np.abs(f - even) <= RESOLUTION * np.maximum(1, np.arange(f.size)), False)))
    return count if count >= 3 and np.allclose(f[:count], np.linspace(f[0], f[count - 1], count), 0, RESOLUTION) else 0


def in_sweeps(found: Sequence[Segment], most_segments: int, most_points: int) -> Iterator[list[Segment]]:
    """The segments of successive sweeps, in each no more segments and points than an instrument takes."""
    sweep: list[Segment] = []
    for segment in _cut(found, most_points):
        if sweep and (len(sweep) == most_segments or sum(s.points for s in sweep) + segment.points > most_points):
            yield sweep
            sweep = []
        sweep.append(segment)
    if sweep:
        yield sweep


def _cut(found: Sequence[Segment], most: int) -> Iterator[Segment]:
    """The segments, long ones split so that each has 2 … `most` points."""
    for segment in found:
        f = segment.frequency
        while f.size > most:
            size = most if f.size - most != 1 else most - 1
            yield Segment(float(f[0]), float(f[size - 1]), size)
            f = f[size:]
        yield Segment(float(f[0]), float(f[-1]), f.size)


def segment_csv(found: Sequence[Segment]) -> str:
    """A table to type into an analyser: start and stop in Hz, and points, of every segment."""
    rows = [f"{one.start:.3f},{one.stop:.3f},{one.points}" for one in found]
    return "\n".join(["start_Hz,stop_Hz,points", *rows]) + "\n"


def segment_data(found: Sequence[Segment]) -> str:
    """The argument of the E4990A's :SENS1:SEGM:DATA: start and stop, everything else as set for the channel.

    Keysight E4990A help, Command Reference, :SENSe<Ch>:SEGMent:DATA: {7, stimulus mode, OSC level, bias, measurement
    time, averaging, segment time and delay of each segment on or off, number of segments, start, stop, points, …}.
    """
    rows = [f"{one.start:.3f},{one.stop:.3f},{one.points}" for one in found]
    return ",".join(["7,0,0,0,0,0,0,0", str(len(found)), *rows])
