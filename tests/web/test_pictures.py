"""Drawings of bodies and figures for the browser: every part at its place."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest

from femu_piezo.specimen.geometry import Geometry
from femu_piezo.web.charts import VIEWS, control_chart, impedance_chart, residual_chart
from femu_piezo.web.drawing import drawing

PLATE = {"shape": "plate", "length": 0.04, "width": 0.005, "thickness": 0.001}
BODIES = (
    PLATE,
    PLATE | {"poling": "length"},
    PLATE | {"electrode_length": 0.02, "electrode_start": 0.002, "hole_diameter": 0.002},
    PLATE | {"wrap_length": 0.003, "wrap_gap": 0.001},
    {"shape": "square", "length": 0.01, "thickness": 0.002, "corner_radius": 0.001, "electrode_margin": 0.0005},
    {"shape": "trapezoid", "length": 0.04, "width": 0.01, "width_end": 0.005, "thickness": 0.001},
    {"shape": "disk", "diameter": 0.01, "thickness": 0.03, "poling": [1, 0, 0]},
    {"shape": "ring", "diameter": 0.01, "inner_diameter": 0.004, "thickness": 0.001},
)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: "-".join(map(str, body.values())))
def test_bodies_are_drawn_within_the_paper(body: dict) -> None:
    found = re.match(r"<svg.*</svg>", drawing(Geometry.model_validate(body)))
    picture = ElementTree.fromstring(found[0])
    assert body["shape"] in picture.get("aria-label")
    corners = [
        [float(value) for value in point.split(",")]
        for polygon in picture.iter("polygon")
        for point in polygon.get("points").split()
    ]
    assert np.min(corners) >= 0 and np.all(np.max(corners, axis=0) <= [460, 260])
    span = np.ptp(corners, axis=0)
    assert span[0] > 300 or span[1] > 140  # it fills the paper


def test_the_caption_says_where_the_electrodes_are() -> None:
    """On the two large faces, or on the two ends of a bar that is poled along its length."""
    captions = [drawing(Geometry.model_validate(body)).rpartition("<p>")[2] for body in BODIES[:2]]
    assert ["electrodes on both faces" in words for words in captions] == [True, False]
    assert ["electrodes on both ends" in words for words in captions] == [False, True]


def test_the_drawing_shows_the_proportions() -> None:
    """The long edge of a plate ten times as long is ten times that of a square plate, at the same scale."""

    def edges(length: float) -> tuple[float, float]:
        text = drawing(Geometry.model_validate(PLATE | {"length": length, "width": 0.01}))
        outline = next(p for p in re.findall(r'points="([^"]+)" fill="#d9cdb8"', text))
        a, b, c, _ = np.array([[float(v) for v in point.split(",")] for point in outline.split()])
        return np.linalg.norm(b - a), np.linalg.norm(c - b)

    (long, across), (side, other) = edges(0.1), edges(0.01)
    assert long / across == pytest.approx(10 * side / other, rel=0.02)


def test_impedance_charts_show_curves_resonances_faults_and_masks() -> None:
    frequency = np.linspace(1e3, 9e3, 20001)
    z = np.exp(1j * frequency / 1e3)
    for view in VIEWS:
        figure = impedance_chart(
            {"a": (frequency, z), "b": (frequency[:50], z[:50])},
            view,
            resonances=[{"kind": "pole", "frequency_Hz": 5e3, "std_Hz": 10.0}, {"kind": "zero", "frequency_Hz": 6e3}],
            faults=[("a spike", frequency[[100, 200]])],
            masked=[(2e3, 3e3)],
            measured="a",
        )
        assert all(len(trace["x"]) == len(trace["y"]) <= 6000 for trace in figure["data"])
        shapes = figure["layout"]["shapes"]
        if view == VIEWS[2]:
            assert len(figure["data"]) == 2 and not shapes
            assert figure["data"][0]["x"][0] == pytest.approx(1e3 * (1 / z[0]).real)
            continue
        assert len(figure["data"]) == 5 and figure["data"][4]["x"] == pytest.approx(frequency[[100, 200]] / 1e3)
        places = [(one["x0"], one["x1"]) for one in shapes]
        assert places == [(2.0, 3.0), pytest.approx((4.98, 5.02)), (5.0, 5.0), (6.0, 6.0)]
    upper, lower = impedance_chart({"a": (frequency[:9], z[:9])}, VIEWS[1])["data"]
    assert upper["y"] == pytest.approx(z[:9].real) and lower["y"] == pytest.approx(z[:9].imag)


def test_residuals_and_limits_stand_where_they_belong() -> None:
    left = np.array([1 + 2j, -3 + 0.5j])
    figure = residual_chart(np.array([1e3, 2e3]), {"after": left}, "residual (σ)", band=2.0)
    assert [trace["y"] for trace in figure["data"]] == [[1, -3], [2, 0.5]]
    assert (figure["layout"]["shapes"][0]["y0"], figure["layout"]["shapes"][0]["y1"]) == (-2, 2)
    chart = control_chart([1, 2], [5.0, 6.0], (4.0, 7.0), "s11")
    assert [line["y0"] for line in chart["layout"]["shapes"]] == [4.0, 7.0]
