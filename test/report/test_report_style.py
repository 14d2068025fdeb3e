"""report.style: envelopes and SVG texts."""

from __future__ import annotations

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import matplotlib
import numpy as np
import pytest

from kr270_milling.report.style import envelope, line, new_figure, plain, styled, svg_text


@pytest.mark.parametrize("size", [1, 2, 99, 1003, 50_001])
def test_envelope_keeps_ends_extrema_and_order_and_bounds_the_number_of_points(size):
    rng = np.random.default_rng(size)
    x, y = np.arange(size) * 0.1, rng.standard_normal(size)
    thin_x, thin_y = envelope(x, y, buckets=50)
    assert thin_x.size <= max(size if size <= 102 else 0, 102)
    assert {thin_y.min(), thin_y.max()} == {y.min(), y.max()}
    assert (thin_x[0], thin_x[-1]) == (x[0], x[-1])
    assert np.all(np.diff(thin_x) > 0)
    assert np.array_equal(thin_y, y[np.rint(thin_x / 0.1).astype(int)])  # every point is one of the series


def test_envelope_keeps_a_single_spike_in_every_bucket():
    y = np.zeros(10_000)
    spikes = np.arange(37, 10_000, 100)
    y[spikes] = np.where(np.arange(spikes.size) % 2, 1.0, -1.0)
    x, thin = envelope(np.arange(y.size), y, buckets=100)
    assert set(spikes) <= set(x)


def test_envelope_survives_missing_values():
    y = np.sin(np.arange(5000) * 0.01)
    y[1000:2000] = np.nan
    _, thin = envelope(np.arange(y.size), y, buckets=40)
    assert np.nanmax(thin) == np.nanmax(y)
    assert np.nanmin(thin) == np.nanmin(y)


@styled
def _figure(label: str):
    figure, ((axes,),) = new_figure(2.0)
    line(axes, np.arange(20_000), np.sin(np.arange(20_000)), "#000000", plain(label))
    axes.legend()
    return figure


def test_the_same_figure_is_the_same_small_xml_text():
    first, second = svg_text(_figure("a")), svg_text(_figure("a"))
    assert first == second
    assert len(first) < 60_000
    assert ET.fromstring(first).tag.endswith("svg")
    assert not re.search(r"\d{4}-\d\d-\d\dT", first)  # no date


def test_texts_stay_texts_and_are_escaped():
    root = ET.fromstring(svg_text(_figure("<script>alert('$x$')</script> & co")))
    texts = ["".join(e.itertext()) for e in root.iter("{http://www.w3.org/2000/svg}text")]
    assert "<script>alert('$x$')</script> & co" in texts
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))


def test_the_callers_own_settings_neither_count_nor_change():
    expected = svg_text(_figure("a"))
    with matplotlib.rc_context({"font.size": 30.0, "svg.hashsalt": "other"}):
        assert svg_text(_figure("a")) == expected
        assert matplotlib.rcParams["font.size"] == 30.0


def test_drawing_never_loads_pyplot():
    program = (
        "import sys; from kr270_milling.report.style import new_figure, styled, svg_text;"
        "svg_text(styled(lambda: new_figure(2.0)[0])()); print('matplotlib.pyplot' in sys.modules)"
    )
    options = dict(cwd=Path(__file__).parents[2], capture_output=True, text=True, timeout=60, check=True)
    ran = subprocess.run([sys.executable, "-c", program], **options)
    assert ran.stdout.strip() == "False"
