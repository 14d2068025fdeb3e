"""The statement about chatter: a cut below the limit depth is stable, one above it is not, a short one says nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from kr270_milling.base.record import find_file
from kr270_milling.cell.cell import read_cell
from kr270_milling.cell.jobs import simulate
from kr270_milling.decision.check import check
from kr270_milling.decision.check_cut import stability_of
from kr270_milling.studies.lobes import lobes

#: an arm that chatters: one light mode across the feed
SOFT = (
    "dynamics.modes=[{frequency_hz: 60, damping_ratio: 0.02, shape: [0.0, 0.2, 0.0, 0.0, 0.0, 0.0]}]",
    "dynamics.reference_inertia=false", "stock.grid_step_um=20", "path.length_mm=20",
    "tool.spindle_speed_rpm=800", "path.feed_rate_m_per_min=0.4", "exchange.period_ms=0.625",  # teeth at 53 Hz
)  # fmt: skip


def soft(depth: float):
    return read_cell(find_file("paper.yaml"), [*SOFT, f"path.depth_of_cut_mm={depth * 1e3}"])


@pytest.fixture(scope="module")
def limit() -> float:
    cell = soft(1e-3)
    (lobe,) = lobes(cell, [cell.tool.spindle_speed])
    return lobe.depth_limit


@pytest.mark.parametrize("share, word", [(0.5, "stable"), (2.0, "chatter")])
def test_what_the_lobes_call_stable_is_stable_in_the_pass(limit, share, word):
    cell = soft(share * limit)
    found = stability_of(cell, simulate(cell).result)
    assert found.word == word, (limit, found)


def test_a_chattering_cut_must_not_be_run(limit):
    checked = check(soft(2.0 * limit))
    assert not checked.may_be_run and {"chatter", "deflection"} & {f.what for f in checked.findings}


def test_the_papers_cut_is_stable_and_a_short_one_says_nothing(demo):
    ran = demo.passes["original"]
    cell = read_cell(find_file("paper.yaml"))
    assert stability_of(cell, ran.result).word == "stable"
    short = {f.name: getattr(ran.result, f.name) for f in dataclasses.fields(ran.result)}
    short = {k: v[:200] if isinstance(v, np.ndarray) else v for k, v in short.items()}
    found = stability_of(cell, type(ran.result)(**short))
    assert found.word == "no statement" and np.isnan(found.residue) and "no statement" in found.text
