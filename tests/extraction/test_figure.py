"""The picture of an extraction carries the data, the fit, the residual and the columns."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from femu_piezo.extraction import extract
from femu_piezo.measurement.readers import read_spectrum, write_spectrum
from femu_piezo.measurement.spectrum import ImpedanceSpectrum
from femu_piezo.output.extraction_plots import extraction_figure
from tests.commands import succeeded

from .bar import Bar, sweep

BAR = Bar()


@pytest.mark.parametrize(
    ("method", "frequency"),
    [("maximum_likelihood", np.linspace(28e3, 48e3, 301)), ("prony_ss", np.arange(100.0, 100_001.0, 250.0))],
)
def test_figure_shows_fit_residual_and_diagram(method, frequency, tmp_path):
    data = sweep(BAR, frequency, relative=1e-3, seed=1)
    extraction = extract(data, method=method)
    figure = extraction_figure(extraction)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert {"|Z| (Ω)", "phase of Z (°)", "residual of Z (σ)", "model order (poles)", "model order (zeros)"} <= set(
        labels
    )
    magnitude, residual = (figure.axes[labels.index(name)] for name in ("|Z| (Ω)", "residual of Z (σ)"))
    drawn = {line.get_label(): line for line in magnitude.get_lines()}
    assert drawn["measured"].get_ydata() == pytest.approx(np.abs(data.impedance))
    assert drawn["fit"].get_ydata() == pytest.approx(np.abs(extraction.impedance))
    points = np.concatenate([line.get_ydata() for line in residual.get_lines()])
    # Re and Im over their deviations: unit variance, within four deviations of a sample variance
    assert np.var(points) == pytest.approx(1, abs=4 * np.sqrt(2 / points.size))
    columns = [
        line for line in figure.axes[labels.index("model order (poles)")].get_lines() if len(line.get_xdata()) == 2
    ]
    at = min(abs(line.get_xdata()[0] * 1e3 - extraction.resonances.poles[0].frequency_Hz) for line in columns)
    assert at < 5
    figure.savefig(tmp_path / "extraction.png")


def test_figure_of_too_few_points_says_so(tmp_path):
    data = sweep(BAR, np.linspace(34e3, 36e3, 5))
    figure = extraction_figure(extract(data))
    written = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    assert "the sweep has 5 usable points" in written and "background needs 8" in written
    assert figure.axes[0].get_lines()[0].get_ydata() == pytest.approx(np.abs(data.impedance))
    assert all(axes.get_lines() or axes.texts for axes in figure.axes)  # none is empty
    figure.savefig(tmp_path / "extraction.png")


def test_a_sweep_without_loss_has_its_curve_and_the_reason_alone(tmp_path):
    frequency = np.linspace(20e3, 60e3, 801)
    write_spectrum(ImpedanceSpectrum(frequency, 1j * sweep(BAR, frequency).impedance.imag), tmp_path / "sweep.csv")
    succeeded("extract", tmp_path / "sweep.csv", "--method", "prony-ss", "--out", tmp_path / "out")
    assert {one.name for one in (tmp_path / "out").iterdir()} == {"extraction.json", "extraction.png"}
    assert "there is no prony_ss.png" in " ".join(succeeded("extract", "--help").output.split())
    figure = extraction_figure(extract(read_spectrum(tmp_path / "sweep.csv"), method="prony_ss"))
    assert len(figure.axes) == 3 and all(axes.get_lines() or axes.texts for axes in figure.axes)


def test_extraction_does_not_import_matplotlib():
    import subprocess

    code = "import sys, femu_piezo.extraction; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_notes_on_the_sweep_are_in_the_record():
    """What is wrong with the readings, as the terminal tells it, stands in extraction.json too."""
    spectrum = replace(sweep(Bar(), np.linspace(28e3, 48e3, 101), relative=1e-3), notes=("two points are spikes",))
    assert extract(spectrum).to_json()["notes"][0] == "two points are spikes"
